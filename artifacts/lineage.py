"""The ancestors of an artifact, as far as their files still exist."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from artifacts.errors import ArtifactError
from artifacts.paths import is_missing, parent_path
from artifacts.schema import Parent
from artifacts.store import Artifact, is_unchanged, read_artifact

MOST_READ = 256 << 20  # bytes; schema 1 files up to this size are read whole, larger ones are compared by date


@dataclass(frozen=True)
class Ancestor:
    """A file that an artifact was made from, directly or indirectly.

    Attributes:
      depth: 1 for a parent, 2 for a parent's parent, and so on.
      parent: The parent as the child recorded it.
      path: Where the file is, or should be.
      state: `present`, `missing`, `unreadable`, or `changed` (replaced by another file).
      artifact: The opened file, if it is present.
      problem: A one-line description of the problem; empty if there is none.
    """

    depth: int
    parent: Parent
    path: Path
    state: str
    artifact: Artifact | None = None
    problem: str = ""


def ancestors(
    artifact: Artifact, parents: Sequence[Parent] | None = None, *, check: bool = False
) -> Iterator[Ancestor]:
    """Yield the files that an artifact was made from, depth first; a missing or unreadable file ends its branch.

    A file that several files were made from is yielded for each of them, but what it was made from itself only once.

    Args:
      artifact: The child.
      parents: The parents to follow; None: all.
      check: Whether to compare each file's content with what the child recorded.
    """
    first = artifact.manifest.parents if parents is None else parents
    waiting = [(1, artifact, parent) for parent in reversed(first)]
    opened: dict[Path, Artifact | ArtifactError] = {}
    followed: set[Path] = set()
    while waiting:
        depth, child, parent = waiting.pop()
        path = parent_path(child.path, parent)
        if path not in opened:
            opened[path] = _opened(path)
        found = opened[path]
        if isinstance(found, ArtifactError):
            yield Ancestor(depth, parent, path, "missing" if is_missing(path) else "unreadable", problem=str(found))
        elif check and _changed(child, parent, found):
            yield Ancestor(depth, parent, path, "changed", problem=f"{path} has changed since")
        else:
            yield Ancestor(depth, parent, path, "present", found)
            if path not in followed:
                followed.add(path)
                waiting.extend((depth + 1, found, grandparent) for grandparent in reversed(found.manifest.parents))


def _opened(path: Path) -> Artifact | ArtifactError:
    try:
        return read_artifact(path)
    except ArtifactError as error:
        return error


def _changed(child: Artifact, parent: Parent, found: Artifact) -> bool:
    must_be_read = not (parent.content and found.manifest.content)
    if must_be_read and found.path.stat().st_size > MOST_READ:
        return found.manifest.created > child.manifest.created
    return not is_unchanged(parent, found)
