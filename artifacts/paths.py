"""How artifacts are named, found and told apart."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from artifacts.schema import KINDS, Parent


def sha256_of(path: str | Path) -> str:
    """Return the sha256 of a file's bytes, in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def default_path(runs: str | Path, name: str, kind: str) -> Path:
    """`runs/NAME.KIND.h5`."""
    return Path(runs) / f"{name}.{kind}.h5"


def sibling(path: str | Path, suffix: str) -> Path:
    """The file beside an artifact: `x.demos.h5` and `.mp4` give `x.demos.mp4`."""
    path = Path(path)
    return path.with_name(path.name.removesuffix(".h5") + suffix)


def stem_of(path: str | Path) -> str:
    """The NAME in `NAME.KIND.h5`."""
    stem = Path(path).name.removesuffix(".h5").removesuffix(".checkpoint")
    name, _, kind = stem.rpartition(".")
    return name if name and kind in KINDS else stem


def parent_path(child: str | Path, parent: Parent) -> Path:
    """Where a parent is, or should be: the recorded path starts at the real folder of the child.

    If the child's folder is reached by a link, the path is still given the way that the caller came, as long as it
    leads to the same file, or the real one leads nowhere.
    """
    folder = Path(child).parent
    path = Path(os.path.normpath(folder / parent.path))
    real = Path(os.path.normpath(folder.resolve() / parent.path))
    if real.is_file() and not (path.is_file() and path.samefile(real)):
        return real
    return path
