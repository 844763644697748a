"""Checks the heaps of variable-length data and texts in an HDF5 file, because HDF5 never returns from a damaged one."""

from __future__ import annotations

import functools
import mmap
import os
import struct
from pathlib import Path

from artifacts import ArtifactError

START = b"GCOL\x01"  # signature and version of a heap
SIZE = struct.Struct("<8xQ")  # size of a heap, with this header
ITEM = struct.Struct("<H6xQ")  # number and size of an item; number 0 is free space, whose size includes this header
SMALLEST = 4096  # bytes of a heap
MOST_ITEMS = 10_000_000  # of all heaps


def check_heaps(path: Path) -> None:
    """Raise ArtifactError if HDF5 would loop forever in a heap of the file. A file is searched once."""
    status = os.stat(path)
    _check(path, (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns))


@functools.lru_cache(maxsize=16)
def _check(path: Path, identity: tuple[int, ...]) -> None:
    del identity  # Only distinguishes a changed file.
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at, items = data.find(START), 0
        while 0 <= at <= len(data) - SMALLEST:
            (size,) = SIZE.unpack_from(data, at)
            place, end = at + SIZE.size, at + size
            while SMALLEST <= size <= len(data) - at and place + ITEM.size <= end:
                number, length = ITEM.unpack_from(data, place)
                items += 1
                if (number == 0 and length == 0) or items > MOST_ITEMS:
                    raise ArtifactError(f"{path}: is truncated or damaged (a heap without an end): download it again")
                place += length if number == 0 else ITEM.size + -(-length // 8) * 8
            at = data.find(START, at + 1)
