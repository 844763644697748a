"""Atomic writing: files and folders appear complete or not at all."""

from __future__ import annotations

import errno
import fcntl
import glob
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from artifacts.errors import PlatformError
from artifacts.interrupts import deferred_interrupts
from artifacts.paths import real

LONGEST_PREFIX = 200  # bytes of the name; file systems allow 255


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path that replaces `path` if the block succeeds.

    If `path` is a symbolic link, the file that it leads to is replaced, and the link is kept. The temporary path is in
    a temporary folder next to that file. The file is fsynced and renamed, and then its folder is fsynced; on any
    exception the file is removed. The folder is created if it is missing.

    Raises:
      PlatformError: The file cannot be written (no space, no permission, a folder of that name).
    """
    path = Path(path)
    with _making(path, real(path)) as temporary:
        if real(path).is_symlink():
            raise OSError(errno.ELOOP, "its symbolic links lead in a circle")
        if os.path.exists(path) and not os.path.isfile(path):
            what = "a folder" if os.path.isdir(path) else "a pipe, socket or device"
            raise FileExistsError(0, f"{what} of that name exists")
        yield temporary


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield an empty temporary folder that becomes `path` if the block succeeds.

    Like `atomic_path`, but for all files in a folder, and nothing is replaced.

    Raises:
      PlatformError: The folder cannot be written, or a file or folder of that name exists.
    """
    path = Path(path)
    with _making(path, path) as temporary:
        temporary.mkdir()
        yield temporary
        if os.path.lexists(path):
            raise FileExistsError(0, "a file or folder of that name exists")


@contextmanager
def _making(named: Path, path: Path) -> Iterator[Path]:
    """Yield a path in a temporary folder used only by this writer, and rename the result to `path` at the end.

    Raises:
      PlatformError: `path`, which the user knows as `named`, cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_abandoned(path)
        with _locked_folder(path) as folder:
            temporary = folder / "new"
            yield temporary
            for file in (*temporary.rglob("*"), temporary):
                _fsync(file)
            os.replace(temporary, path)
        _fsync(path.parent)
    except OSError as error:
        if isinstance(error.__context__, KeyboardInterrupt):  # The clean-up that it interrupted failed.
            raise error.__context__ from None
        reason = " ".join((error.strerror or str(error)).split())
        raise PlatformError(
            f"{named}: cannot be written ({reason}): free some space or choose another location"
        ) from error


@contextmanager
def _locked_folder(path: Path) -> Iterator[Path]:
    """Yield a new folder with a random name next to `path`, locked while its writer is alive, and remove it at the end.

    It is a kernel lock: it works across containers that share the volume, and is released when the process ends.
    """
    held: list[tuple[Path, int | None]] = []
    try:
        with deferred_interrupts():
            held.append(_new_locked_folder(path))
        yield held[0][0]
    finally:
        try:
            _release(held)
        except KeyboardInterrupt:
            _release(held)  # The interrupt may have come before it was deferred.
            raise


def _release(held: list[tuple[Path, int | None]]) -> None:
    """Remove the folders and release their locks, once. An interrupt in the middle would leave a folder behind."""
    with deferred_interrupts():
        while held:
            folder, lock = held.pop()
            shutil.rmtree(folder, ignore_errors=True)
            if lock is not None:
                os.close(lock)


def _new_locked_folder(path: Path) -> tuple[Path, int | None]:
    while True:
        folder = Path(tempfile.mkdtemp(prefix=_prefix(path), dir=path.parent))
        with suppress(FileNotFoundError):
            lock = _lock(folder)
            if folder.exists():
                return folder, lock
            if lock is not None:
                os.close(lock)
        # Another writer considered it abandoned, and removed it before it was locked.


def _prefix(path: Path) -> str:
    # A file system that has room for the name must have room for this one as well.
    return f".{os.fsdecode(os.fsencode(path.name)[:LONGEST_PREFIX])}.tmp-"


def _lock(path: Path, wait: bool = True) -> int | None:
    """Lock a file or folder, and return the descriptor that holds the lock; None: this file system has no locks.

    Raises:
      BlockingIOError: Its writer is alive, and `wait` is False.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # It may be anything that has such a name, also a pipe.
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        os.close(descriptor)
        raise
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def write_bytes(path: str | Path, data: bytes) -> Path:
    """Write a small file atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return Path(path)


def _fsync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def remove_abandoned(path: Path) -> None:
    """Remove what killed writers of the same file left behind: temporary folders that nobody locks."""
    for other in path.parent.glob(f"{glob.escape(_prefix(path))}*"):
        with suppress(OSError):
            lock = _lock(other, wait=False)
            if lock is not None:
                _remove(other)
                os.close(lock)
