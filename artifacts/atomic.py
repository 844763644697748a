"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from artifacts.errors import PlatformError

ABANDONED_AFTER = 600.0  # seconds; a live writer touches its file far more often


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder that replaces `path` if the block succeeds.

    The file is fsynced, renamed, and the folder fsynced; on any exception it is removed.
    The folder is made if missing.

    Raises:
      PlatformError: the file cannot be written (no room, no leave, a folder in the way).
    """
    path = Path(path)
    with _making(path) as temporary:
        if path.is_dir():
            raise IsADirectoryError(0, "a folder of that name is in the way")
        yield temporary


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield a temporary folder beside `path`, empty, that becomes `path` if the block succeeds.

    As `atomic_path`, for all files in it; but nothing is replaced.

    Raises:
      PlatformError: it cannot be written, or there is something of that name.
    """
    path = Path(path)
    with _making(path) as temporary:
        temporary.mkdir()
        yield temporary
        if path.exists():
            raise FileExistsError(0, "something of that name is in the way")


@contextmanager
def _making(path: Path) -> Iterator[Path]:
    temporary = path.with_name(f".{path.name}.tmp-{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(path)
        try:
            yield temporary
            for file in (*temporary.rglob("*"), temporary):
                _fsync(file)
            os.replace(temporary, path)
        except BaseException:
            _remove(temporary)
            raise
        _fsync(path.parent)
    except OSError as error:
        reason = " ".join((error.strerror or str(error)).split())
        raise PlatformError(f"{path}: cannot be written ({reason}): free some room or choose another place") from error


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


def _remove_abandoned(path: Path) -> None:
    """Remove what a killed writer of this same file left: its process gone, untouched for a while."""
    prefix = f".{path.name}.tmp-"
    for other in path.parent.iterdir():
        pid = other.name.removeprefix(prefix)
        if not other.name.startswith(prefix) or not pid.isdigit() or Path("/proc", pid).exists():
            continue
        with suppress(OSError):
            touched = max(file.stat().st_mtime for file in (other, *other.rglob("*")))
            if time.time() - touched > ABANDONED_AFTER:
                _remove(other)
