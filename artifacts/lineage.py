"""What an artifact was made from, as far as the files are still there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from artifacts.errors import ArtifactError
from artifacts.paths import parent_path
from artifacts.schema import Parent
from artifacts.store import Artifact, is_unchanged, read_artifact

MOST_READ = 256 << 20  # bytes of the largest file of schema 1 that is read whole; the date of a larger one must do


@dataclass(frozen=True)
class Ancestor:
    """A file that an artifact was made from, directly or through others.

    Attributes:
      depth: 1 for a parent, 2 for a parent's parent, and so on.
      parent: what the child recorded.
      path: where the file is, or should be.
      state: `present`, `missing`, `unreadable`, or `changed` (another file has taken its place).
      artifact: the file, opened, if it is present.
      problem: what is wrong with it, in one line; empty if nothing is.
    """

    depth: int
    parent: Parent
    path: Path
    state: str
    artifact: Artifact | None = None
    problem: str = ""


def ancestors(
    artifact: Artifact, parents: Sequence[Parent] | None = None, *, check: bool = False, depth: int = 1
) -> Iterator[Ancestor]:
    """Yield what an artifact was made from, depth first; a file that is gone or unreadable ends its branch.

    Args:
      artifact: the child.
      parents: those of its parents to follow; None: all.
      check: whether to compare each file's content with what the child recorded.
      depth: of the first generation.
    """
    for parent in artifact.manifest.parents if parents is None else parents:
        path = parent_path(artifact.path, parent)
        try:
            found = read_artifact(path)
        except ArtifactError as error:
            state = "unreadable" if path.exists() else "missing"
            yield Ancestor(depth, parent, path, state, problem=str(error))
            continue
        if check and _changed(artifact, parent, found):
            yield Ancestor(depth, parent, path, "changed", problem=f"{path} has changed since")
            continue
        yield Ancestor(depth, parent, path, "present", found)
        yield from ancestors(found, check=check, depth=depth + 1)


def _changed(child: Artifact, parent: Parent, found: Artifact) -> bool:
    must_be_read = not (parent.content and found.manifest.content)
    if must_be_read and found.path.stat().st_size > MOST_READ:
        return found.manifest.created > child.manifest.created
    return not is_unchanged(parent, found)
