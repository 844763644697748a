"""Paths of artifacts and of the files that belong to them."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from io import BufferedReader
from pathlib import Path

from artifacts.schema import KINDS, Parent


def sha256_of(path: str | Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def open_regular(path: str | Path) -> BufferedReader:
    """Open a file for reading.

    Raises:
      OSError: It cannot be read, or is a pipe or a device, from which reading might never end.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # Opening a pipe would wait for its writer.
    try:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        return open(descriptor, "rb")
    except OSError:
        os.close(descriptor)
        raise


def default_path(runs: str | Path, name: str, kind: str) -> Path:
    """Return the default path of an artifact, `runs/NAME.KIND.h5`."""
    return Path(runs) / f"{name}.{kind}.h5"


def sibling(path: str | Path, suffix: str) -> Path:
    """Return the path of a file that belongs to an artifact: `x.demos.h5` and `.mp4` give `x.demos.mp4`."""
    path = Path(path)
    return path.with_name(path.name.removesuffix(".h5") + suffix)


def stem_of(path: str | Path) -> str:
    """Return the NAME in `NAME.KIND.h5`."""
    stem = Path(path).name.removesuffix(".h5").removesuffix(".checkpoint")
    name, _, kind = stem.rpartition(".")
    return name if name and kind in KINDS else stem


def parent_path(child: str | Path, parent: Parent) -> Path:
    """Return where a parent is, or should be. The recorded path is relative to the real folder of the child.

    If the caller reached the child's folder through a link, the returned path goes through the same link, provided that
    it leads to the same file or that there is no file at the real path.
    """
    folder = Path(child).parent
    path = Path(os.path.normpath(folder / parent.path))
    real = Path(os.path.normpath(folder.resolve() / parent.path))
    if real.is_file() and not (path.is_file() and path.samefile(real)):
        return real
    return path
