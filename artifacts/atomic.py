"""Files that appear whole or not at all."""

from __future__ import annotations

import os
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
    temporary = path.with_name(f".{path.name}.tmp-{os.getpid()}")
    try:
        if path.is_dir():
            raise IsADirectoryError(0, "a folder of that name is in the way")
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(path)
        try:
            yield temporary
            with open(temporary, "rb") as file:
                os.fsync(file.fileno())
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        _fsync_folder(path.parent)
    except OSError as error:
        reason = " ".join((error.strerror or str(error)).split())
        raise PlatformError(f"{path}: cannot be written ({reason}): free some room or choose another --out") from error


def write_bytes(path: str | Path, data: bytes) -> Path:
    """Write a small file atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return Path(path)


def _fsync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove_abandoned(path: Path) -> None:
    """Remove what a killed writer of this same file left: its process gone, untouched for a while."""
    prefix = f".{path.name}.tmp-"
    for other in path.parent.iterdir():
        pid = other.name.removeprefix(prefix)
        if not other.name.startswith(prefix) or not pid.isdigit() or Path("/proc", pid).exists():
            continue
        with suppress(OSError):
            if time.time() - other.stat().st_mtime > ABANDONED_AFTER:
                other.unlink()
