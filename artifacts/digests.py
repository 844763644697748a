"""The digest of a dataset, which shows whether its data is undamaged.

The digest is 128-bit XXH3 over the type, the shape and the stored bytes in C order. It does not protect against an
author who creates a collision on purpose. It was chosen for its speed (`benchmarks/verify.py`): with SHA-256, writing
and reading demonstrations would take about one and a half times as long.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np

BLOCK_BYTES = 8 << 20  # largest part of a dataset that is in memory at once to compute the digest


class DatasetDigest:
    """The digest of one dataset, fed piece by piece in C order."""

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype) -> None:
        import xxhash

        # Unicode strings are stored as UTF-8, so their byte order in memory is not a property of the stored data.
        name = f"U{dtype.itemsize // 4}" if dtype.kind == "U" else dtype.str
        self._hash = xxhash.xxh3_128(json.dumps([name, [int(length) for length in shape]]).encode())

    def update(self, piece: np.ndarray) -> None:
        """Add the next piece of the stored data."""
        self._hash.update(np.ascontiguousarray(piece).reshape(-1).view(np.uint8).data)

    def hexdigest(self) -> str:
        return str(self._hash.hexdigest())


def blocks(shape: tuple[int, ...], itemsize: int, chunks: tuple[int, ...] | None = None) -> Iterator[tuple[slice, ...]]:
    """Yield selections that cover an array in C order, each of at most BLOCK_BYTES.

    Args:
      shape: Shape of the array; empty arrays yield nothing.
      itemsize: Bytes per element.
      chunks: Shape of the chunks in which the array is stored; blocks end at chunk boundaries if chunks fit.
    """
    if 0 in shape:
        return
    room, whole = max(1, BLOCK_BYTES // itemsize), len(shape)
    while whole and shape[whole - 1] <= room:
        whole -= 1
        room //= shape[whole]
    rest = tuple(slice(0, length) for length in shape[whole:])
    if not whole:
        yield rest
        return
    cut = whole - 1
    step = max(1, room)
    if chunks and chunks[cut] <= step:
        step -= step % chunks[cut]
    for index in np.ndindex(*shape[:cut]):
        for start in range(0, shape[cut], step):
            yield (*(slice(i, i + 1) for i in index), slice(start, min(start + step, shape[cut])), *rest)
