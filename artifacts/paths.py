"""Paths of artifacts and of the files that belong to them."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from io import BufferedReader
from pathlib import Path

from artifacts.errors import ArtifactError
from artifacts.kinds import KINDS
from artifacts.schema import Parent

NOT_REGULAR = "not a regular file"


def sha256_of(path: str | Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal.

    Raises:
      ArtifactError: It cannot be read, or is no regular file: a pipe would never end, or be empty the next time.
    """
    try:
        with open_regular(path) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error


def check_regular(path: str | Path) -> None:
    """Check that a path leads to a regular file, without opening it: opening a pipe would wait for its writer.

    Raises:
      OSError: It leads to something else, or nowhere, or is no path at all.
    """
    try:
        mode = os.stat(path).st_mode
    except ValueError as error:  # a NUL character
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL)) from error
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, NOT_REGULAR)


def is_missing(path: str | Path) -> bool:
    """Return whether there is nothing at a path, as opposed to something that cannot be read."""
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        return False
    return False


def real(path: str | Path) -> Path:
    """Return the path without links. Unlike `Path.resolve`, this never raises for a path without NUL characters."""
    return Path(os.path.realpath(path))


def files_below(folder: str | Path, ending: str) -> list[Path]:
    """Return the files with this ending in a folder and its subfolders, sorted; links to folders are not followed.

    Raises:
      ArtifactError: A folder cannot be read, so that files could be overlooked.
    """
    found, folders = [], [Path(folder)]
    while folders:
        current = folders.pop()
        try:
            with os.scandir(current) as entries:
                for entry in entries:
                    if entry.is_dir(follow_symlinks=False):
                        folders.append(Path(entry.path))
                    elif entry.name.endswith(ending) and not os.path.isdir(entry.path):
                        found.append(Path(entry.path))
        except OSError as error:
            raise ArtifactError(f"{current}: cannot be read ({error.strerror}): check its permissions") from error
    return sorted(found)


def open_regular(path: str | Path) -> BufferedReader:
    """Open a file for reading.

    Raises:
      OSError: It cannot be read, or is a pipe or a device, from which reading might never end.
    """
    try:
        # Without O_NONBLOCK, opening a pipe would wait for its writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:  # a NUL character
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL)) from error
    try:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, NOT_REGULAR)
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

    If the caller reached the child through a link, the returned path goes through the same link, provided that
    it leads to the same file or that there is no file at the real path.
    """
    path = Path(os.path.normpath(Path(child).parent / parent.path))
    recorded = Path(os.path.normpath(real(child).parent / parent.path))
    if os.path.isfile(recorded) and not (os.path.isfile(path) and path.samefile(recorded)):
        return recorded
    return path
