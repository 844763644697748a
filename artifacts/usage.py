"""Marks of files and folders that a running process uses, so that others do not remove them.

A mark is a shared lock of the kernel (flock): it works across containers that share the volume, and ends with the
process, however that ends. It keeps nobody from reading. What is marked: the inputs of a running stage, and the folder
of its TensorBoard scalars. The temporary folders of atomic writing are locked exclusively (`artifacts.atomic`).
"""

from __future__ import annotations

import fcntl
import os
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


class InUse:
    """Marks files or folders as used, until `end` is called or the object is no longer referenced.

    What cannot be opened or locked is not marked: some file systems have no locks, and a stage runs without, too.
    """

    def __init__(self, paths: Iterable[str | Path] = ()) -> None:
        descriptors: list[int] = []
        self._end = weakref.finalize(self, _close, descriptors)
        for path in paths:
            with suppress(OSError, ValueError):
                descriptors.append(_locked(path, fcntl.LOCK_SH))

    def end(self) -> None:
        """Remove the marks."""
        self._end()


def is_used(path: str | Path) -> bool:
    """Return whether a running process has marked a file or folder, or, where there are no locks, may use it."""
    with unused(path) as free:
        return not free


@contextmanager
def unused(path: str | Path) -> Iterator[bool]:
    """Yield whether nobody uses a file or folder; if so, nobody can mark it during the block."""
    try:
        descriptor = _locked(path, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        os.close(descriptor)


def _locked(path: str | Path, operation: int) -> int:
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, operation)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _close(descriptors: list[int]) -> None:
    while descriptors:
        with suppress(OSError):
            os.close(descriptors.pop())
