"""What an artifact was made from, as far as the files are still there."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from artifacts.errors import ArtifactError
from artifacts.paths import sha256_of
from artifacts.schema import Parent
from artifacts.store import Artifact, read_artifact

MOST_HASHED = 256 << 20  # bytes of the largest file that is hashed; a larger one's date tells whether it changed


@dataclass(frozen=True)
class Ancestor:
    """A file that an artifact was made from, at first or at second hand.

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
      check: whether to make sure, file by file, that it is the one that the child was made from.
      depth: of the first generation.
    """
    for parent in artifact.manifest.parents if parents is None else parents:
        path = _path_of(artifact, parent)
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


def _path_of(artifact: Artifact, parent: Parent) -> Path:
    folder = artifact.path.parent
    path = Path(os.path.normpath(folder / parent.path))
    real = Path(os.path.normpath(folder.resolve() / parent.path))  # Elsewhere, if the folder is reached by a link.
    return real if real.is_file() and not path.is_file() else path


def _changed(child: Artifact, parent: Parent, found: Artifact) -> bool:
    status = found.path.stat()
    if status.st_size > MOST_HASHED:
        return found.manifest.created > child.manifest.created
    return _digest(found.path.resolve(), status.st_size, status.st_mtime_ns) != parent.sha256


@functools.lru_cache(maxsize=1024)
def _digest(path: Path, size: int, changed: int) -> str:
    """The sha256 of a file; many runs share ancestors, and size and time say whether it is still the same."""
    return sha256_of(path)
