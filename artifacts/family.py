"""Who was made from whom, among artifacts seen at a glance. No data is read: digests of content are compared."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from artifacts.errors import ArtifactError
from artifacts.glance import Glance, glance
from artifacts.paths import is_missing, parent_path, real
from artifacts.schema import Parent

OK, CHANGED, MISSING, UNREADABLE, UNCHECKED = "ok", "changed", "missing", "unreadable", "unchecked"
WORST_FIRST = (MISSING, UNREADABLE, CHANGED, UNCHECKED, OK)


@dataclass(frozen=True)
class Relation:
    """A parent of an artifact, and what has become of it.

    Attributes:
      parent: The parent as the child recorded it.
      path: Where the file is, or should be.
      state: `ok`, `changed` (replaced by other content), `missing`, `unreadable`, or `unchecked` (a file of schema 1
        records no digest of its content).
      found: The file at `path`; None: it is missing or unreadable.
    """

    parent: Parent
    path: Path
    state: str
    found: Glance | None


class Family:
    """The relations among artifacts.

    Args:
      members: The artifacts, each file once. Parents outside of them are looked at when they are asked for.
    """

    def __init__(self, members: Sequence[Glance]) -> None:
        self.members = list(members)
        self._at: dict[Path, Glance | None] = {real(item.path): item for item in members}
        self._inside = dict(self._at)
        self._with_content: dict[str, list[Glance]] = defaultdict(list)
        for item in members:
            if item.manifest.content:
                self._with_content[item.manifest.content].append(item)
        self._parents: dict[Path, list[Relation]] = {}

    def parents(self, child: Glance) -> list[Relation]:
        """Return the parents of an artifact, in the order in which it records them."""
        if child.path not in self._parents:
            self._parents[child.path] = [self._relation(child, parent) for parent in child.manifest.parents]
        return self._parents[child.path]

    def parent(self, child: Glance, kind: str) -> Glance | None:
        """Return the parent of a kind if it has the content that the child recorded, as far as that is known."""
        for relation in self.parents(child):
            if relation.parent.kind == kind:
                return relation.found if relation.state in (OK, UNCHECKED) else None
        return None

    def state(self, child: Glance) -> str:
        """Return the state of the parent that is worst off; empty if the artifact has no parents."""
        states = {relation.state for relation in self.parents(child)}
        return next((state for state in WORST_FIRST if state in states), "")

    def sources(self, child: Glance) -> list[Glance]:
        """Return the members that an artifact may have been made from, each once.

        These are the members at the recorded places, whatever they hold now, and those that have the recorded content,
        wherever they are now.
        """
        found: dict[Path, Glance] = {}
        for relation in self.parents(child):
            member = self._inside.get(real(relation.path))
            for item in [*([member] if member else []), *self._with_content.get(relation.parent.content, [])]:
                found[item.path] = item
        found.pop(child.path, None)
        return list(found.values())

    def needed(self, kept: Iterable[Glance]) -> set[Path]:
        """Return the paths of artifacts and of all members that they were made from, directly or indirectly."""
        waiting, found = list(kept), set[Path]()
        while waiting:
            item = waiting.pop()
            if item.path not in found:
                found.add(item.path)
                waiting.extend(self.sources(item))
        return found

    def descendants_first(self, chosen: Iterable[Glance]) -> list[Glance]:
        """Return artifacts in an order in which each comes before what it was made from."""
        wanted = {item.path: item for item in chosen}
        ordered: list[Glance] = []
        state: dict[Path, bool] = {}  # False: its sources are being visited; True: done
        for first in sorted(wanted):
            waiting = [(wanted[first], False)]
            while waiting:
                item, done = waiting.pop()
                if done:
                    state[item.path] = True
                    ordered.append(item)
                elif item.path not in state:
                    state[item.path] = False
                    waiting.append((item, True))
                    waiting.extend((source, False) for source in self.sources(item) if source.path not in state)
        return [item for item in reversed(ordered) if item.path in wanted]

    def _relation(self, child: Glance, parent: Parent) -> Relation:
        path = parent_path(child.path, parent)
        found = self._look(path)
        if found is None:
            return Relation(parent, path, MISSING if is_missing(path) else UNREADABLE, None)
        if not parent.content or not found.manifest.content:
            return Relation(parent, path, UNCHECKED, found)
        return Relation(parent, path, OK if parent.content == found.manifest.content else CHANGED, found)

    def _look(self, path: Path) -> Glance | None:
        place = real(path)
        if place not in self._at:
            try:
                self._at[place] = glance(path)
            except ArtifactError:
                self._at[place] = None
        return self._at[place]
