"""Checks of how an HDF5 file stores an array, before HDF5 reads it.

HDF5 trusts what a file says about itself. If a stored chunk is shorter than its checksum, the process crashes; if it is
shorter than its shape, whatever lies behind it in memory is returned; chunks that are not stored are filled up.
"""

from __future__ import annotations

import math
import zlib
from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np

from artifacts import ArtifactError

if TYPE_CHECKING:
    import h5py

LARGEST_CHUNK = 2**29  # bytes; HDF5 decompresses a whole chunk to read a part of it
CHECKSUM = 4  # bytes of fletcher32, behind the data
SHUFFLE, LZF = 2, 32000  # identifiers of filters
DEFLATE, FLETCHER32 = 1, 3
AGAIN = "download it again"


class StoredArray:
    """A dataset that can be read item by item along its first axis."""

    def __init__(self, label: str, dataset: h5py.Dataset) -> None:
        """Check that all data is stored.

        Args:
            label: The name used in messages.
            dataset: The dataset, with at least one axis.

        Raises:
            ArtifactError: Data is missing, or it is stored in a way that cannot be checked.
        """
        import h5py

        self._label, self._dataset = label, dataset
        self._chunks: dict[int, list[Any]] | None = None  # By their place along the first axis.
        layout = dataset.id.get_create_plist()
        if layout.get_layout() == h5py.h5d.CHUNKED:
            self._filters = [layout.get_filter(k)[0] for k in range(layout.get_nfilters())]
            self._check_chunks()
        elif dataset.id.get_storage_size() < math.prod(dataset.shape) * dataset.id.get_type().get_size():
            raise ArtifactError(f"{label}: its data is incomplete: {AGAIN}")

    def __getitem__(self, index: int) -> np.ndarray:
        """Read an item.

        Raises:
            ArtifactError: A chunk does not contain what the shape promises.
        """
        if self._chunks is not None:
            for chunk in self._chunks.pop(index // self._dataset.chunks[0], []):
                self._check_expanded(chunk)
        return np.asarray(self._dataset[index])

    def whole(self) -> np.ndarray:
        """Read all items. Raises ArtifactError like reading one."""
        for chunk in [chunk for stored in (self._chunks or {}).values() for chunk in stored]:
            self._check_expanded(chunk)
        return np.asarray(self._dataset[...])

    def _check_chunks(self) -> None:
        shape, chunks = self._dataset.shape, self._dataset.chunks
        self._size = math.prod(chunks) * self._dataset.id.get_type().get_size()
        if not set(self._filters) <= {DEFLATE, SHUFFLE, FLETCHER32, LZF} or self._size > LARGEST_CHUNK:
            raise ArtifactError(
                f"{self._label}: its data is compressed in a way that is not supported: repack it with "
                "h5repack -f GZIP=4"
            )
        count = math.prod(math.ceil(length / chunk) for length, chunk in zip(shape, chunks, strict=True))
        found: dict[int, list[Any]] = defaultdict(list)
        if count <= self._dataset.file.id.get_filesize():  # Otherwise some are missing.
            self._dataset.id.chunk_iter(lambda chunk: found[chunk.chunk_offset[0] // chunks[0]].append(chunk))
        if sum(map(len, found.values())) < count:
            raise ArtifactError(f"{self._label}: its data is incomplete: {AGAIN}")
        self._chunks = found
        for stored in found.values():
            for chunk in stored:
                filters = self._applied(chunk)
                checksum = CHECKSUM * (FLETCHER32 in filters)
                if (chunk.size != self._size + checksum) if not {DEFLATE, LZF} & {*filters} else chunk.size <= checksum:
                    raise ArtifactError(f"{self._label}: its data is damaged (a chunk has the wrong size): {AGAIN}")

    def _applied(self, chunk: Any) -> list[int]:
        """The filters that were applied to a chunk, in order."""
        return [kind for k, kind in enumerate(self._filters) if not chunk.filter_mask >> k & 1]

    def _check_expanded(self, chunk: Any) -> None:
        """Check the size that a compressed chunk expands to."""
        filters = self._applied(chunk)
        packed = {DEFLATE, LZF} & {*filters}
        if not packed:
            return
        _, data = self._dataset.id.read_direct_chunk(chunk.chunk_offset)
        place = filters.index(*packed) if len(packed) == 1 else -1
        before, after = filters[:place], filters[place + 1 :]
        data = data[: len(data) - CHECKSUM * after.count(FLETCHER32)]
        expected = self._size + CHECKSUM * before.count(FLETCHER32)
        expanded = 0
        if place >= 0 and len({*filters}) == len(filters):
            expanded = _inflated(data, expected) if DEFLATE in packed else _size_of_lzf(data)
        if expanded != expected:
            raise ArtifactError(f"{self._label}: its data is damaged (a chunk has the wrong size): {AGAIN}")


def _inflated(data: bytes, expected: int) -> int:
    """The size that zlib's data expands to, or a larger one than expected."""
    try:
        return len(zlib.decompressobj().decompress(data, expected + 1))
    except zlib.error:
        return 0


def _size_of_lzf(data: bytes) -> int:
    """The size that LZF's data expands to."""
    at = size = 0
    while at < len(data):
        control = data[at]
        if control < 32:  # This many bytes follow, and one more.
            at, size = at + control + 2, size + control + 1
        elif control < 224 or at + 1 == len(data):
            at, size = at + 2, size + (control >> 5) + 2
        else:
            at, size = at + 3, size + data[at + 1] + 9
    return size if at == len(data) else 0
