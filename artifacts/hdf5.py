"""The HDF5 layout of arrays, chosen so that damage never goes unnoticed.

Metadata uses the 1.10 file format, whose headers and indices have checksums. Data is chunked, with a fletcher32
checksum per chunk. That early check does not notice zeroed data; the digest in the manifest does. Strings have a fixed
length, because HDF5 has no checksum for the heap of variable-length strings. Two kinds of arrays cannot be chunked: a
0-d array is stored with one element and the attribute `scalar`; an array without elements has no data and is stored
without chunks. Unicode strings are stored as UTF-8, with their width in the attribute `unicode`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from artifacts.digests import DatasetDigest, blocks
from artifacts.errors import ArtifactError
from artifacts.layout import MOST_MANIFEST_BYTES, MOST_NESTED, STORABLE, check_attributes

if TYPE_CHECKING:
    import h5py

WRONG_DIGEST = "its digest is wrong"
SIGNATURE = b"\x89HDF\r\n\x1a\n"
END_OF_FILE_ADDRESS = 28  # offset of the length of the file in the superblock (version 3)
ROOM_FOR_NUMBERS = 1024  # bytes of the manifest
CHUNK_BYTES = 256 * 1024  # about one demonstration of 48x48, which can then be read without its neighbors


def chunk_shape(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Return a chunk of as many whole trailing axes as fit in CHUNK_BYTES, with the next axis cut evenly."""
    room = max(1, CHUNK_BYTES // itemsize)
    chunk = []
    for length in reversed(shape):
        pieces = math.ceil(length / min(length, room))
        chunk.append(math.ceil(length / pieces))
        room = max(1, room // length)
    return tuple(reversed(chunk))


def check_arrays(arrays: Mapping[str, np.ndarray]) -> None:
    """Raise ArtifactError for names or types that the format cannot store."""
    for name, array in arrays.items():
        parts = name.split("/")
        if any(part in ("", ".", "..") or "\0" in part for part in parts):
            raise ArtifactError(f"dataset name {name!r} is not usable: expected parts joined by single slashes")
        if len(parts) > MOST_NESTED:
            raise ArtifactError(f"dataset {name} is nested too deeply: expected at most {MOST_NESTED} parts")
        for i in range(1, len(parts)):
            if "/".join(parts[:i]) in arrays:
                raise ArtifactError(f"dataset {'/'.join(parts[:i])} cannot also be the group of {name}")
        if array.dtype.kind not in STORABLE:
            raise ArtifactError(f"dataset {name} has type {array.dtype}: expected numbers, booleans or strings")


def as_stored(array: np.ndarray) -> tuple[np.ndarray, dict[str, int]]:
    """Return the stored form of an array, and the attributes needed to restore the original."""
    attributes: dict[str, int] = {}
    if array.dtype.kind == "U":
        attributes["unicode"] = array.dtype.itemsize // 4
        array = np.char.encode(array, "utf-8")
    if array.dtype.itemsize == 0:
        array = array.astype("S1")
    if array.ndim == 0:
        attributes["scalar"] = 1
        array = np.asarray(array).reshape(1)
    return array, attributes


def digest_of(array: np.ndarray) -> str:
    """Return the digest that `dataset_digest` will compute after `write_dataset` has stored the array."""
    stored, attributes = as_stored(array)
    digest = DatasetDigest(*_original(stored, attributes))
    if stored.flags.c_contiguous:
        digest.update(stored)
    else:
        for selection in blocks(stored.shape, stored.dtype.itemsize):
            digest.update(stored[selection])
    return digest.hexdigest()


def dataset_digest(dataset: h5py.Dataset, see: Callable[[np.ndarray], None] | None = None) -> str:
    """Read a stored dataset piece by piece and return its digest; `see` is called with each piece."""
    digest = DatasetDigest(*describe(dataset))
    for selection in blocks(dataset.shape, dataset.dtype.itemsize, dataset.chunks):
        piece = dataset[selection]
        digest.update(piece)
        if see:
            see(piece)
    return digest.hexdigest()


def write_dataset(file: h5py.File, name: str, array: np.ndarray) -> None:
    """Store one array with checksums."""
    array, attributes = as_stored(array)
    options: dict[str, Any] = {}
    if array.size:
        options = {"chunks": chunk_shape(array.shape, array.dtype.itemsize), "fletcher32": True}
    dataset = file.create_dataset(name, data=array, **options)
    for key, value in attributes.items():
        dataset.attrs[key] = value


def read_dataset(dataset: h5py.Dataset, selection: Any = ..., digest: str | None = None) -> np.ndarray:
    """Read all or part of an array that `write_dataset` stored, with its original type and shape.

    Args:
      dataset: The dataset in an open file.
      selection: A NumPy-style index.
      digest: Expected digest of the whole dataset, checked if the whole dataset is read. None: unknown.

    Raises:
      OSError: The data is damaged.
    """
    scalar = "scalar" in dataset.attrs
    array = np.asarray(dataset[...] if scalar else dataset[selection])
    if digest is not None and (scalar or _is_whole(selection)):
        found = DatasetDigest(*describe(dataset))
        found.update(array)
        if found.hexdigest() != digest:
            raise OSError(WRONG_DIGEST)
    if "unicode" in dataset.attrs:
        array = np.asarray(np.char.decode(array, "utf-8")).astype(f"U{int(dataset.attrs['unicode'])}")
    return np.asarray(array.reshape(())[selection]) if scalar else array


def _is_whole(selection: Any) -> bool:
    """Return whether a selection certainly covers the whole array."""
    parts = selection if isinstance(selection, tuple) else (selection,)
    return all(part is Ellipsis or (isinstance(part, slice) and part == slice(None)) for part in parts)


def describe(dataset: h5py.Dataset) -> tuple[tuple[int, ...], np.dtype]:
    """Return the shape and type of the array that `read_dataset` returns."""
    return _original(dataset, dataset.attrs)


def _original(stored: h5py.Dataset | np.ndarray, attributes: Mapping[str, Any]) -> tuple[tuple[int, ...], np.dtype]:
    dtype = np.dtype(f"U{int(attributes['unicode'])}") if "unicode" in attributes else stored.dtype
    return (() if "scalar" in attributes else stored.shape), dtype


def write_attributes(file: h5py.File, attributes: Mapping[str, int | str]) -> None:
    """Store the root attributes.

    Raises:
      ArtifactError: They are larger than what is read again.
    """
    import h5py

    if sum(len(str(value).encode()) for value in attributes.values()) > MOST_MANIFEST_BYTES - ROOM_FOR_NUMBERS:
        raise ArtifactError(f"its manifest would need more than {MOST_MANIFEST_BYTES >> 20} MiB: record less in it")
    for name, value in attributes.items():
        if isinstance(value, int):
            file.attrs[name] = np.int64(value)
        else:
            text = value.encode("utf-8")
            file.attrs.create(name, text, dtype=h5py.string_dtype("utf-8", max(1, len(text))))


def read_attributes(file: h5py.File) -> dict[str, int | str]:
    """Return the root attributes, each as int or str.

    Raises:
      ArtifactError: An attribute is of another type, or too long.
    """
    import h5py

    check_attributes(file)
    attributes: dict[str, int | str] = {}
    # Several times as fast as `file.attrs`, which matters to commands that look at hundreds of files.
    for index in range(h5py.h5a.get_num_attrs(file.id)):
        attribute = h5py.h5a.open(file.id, index=index)
        found = np.zeros((), attribute.dtype)
        attribute.read(found)
        value = found[()]
        name = attribute.name.decode("utf-8", "surrogateescape")
        attributes[name] = value.decode("utf-8") if isinstance(value, bytes) else int(value)
    return attributes


def room_for(arrays: Mapping[str, np.ndarray], attributes: Mapping[str, int | str]) -> int:
    """Return an upper bound of the file's size in bytes."""
    room = 1_000_000 + 8 * sum(len(str(value)) for value in attributes.values())
    for name, array in arrays.items():
        room += 4096 + 8 * len(name)
        if array.size:
            shape = array.shape or (1,)
            chunk = chunk_shape(shape, array.dtype.itemsize or 1)
            chunks = math.prod(math.ceil(n / c) for n, c in zip(shape, chunk, strict=True))
            room += chunks * (math.prod(chunk) * (array.dtype.itemsize or 1) + 64)
    return room


def _reserve(path: Path, room: int) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT, 0o666)
    try:
        os.posix_fallocate(descriptor, 0, room)
    finally:
        os.close(descriptor)


@contextmanager
def new_file(path: Path, room: int) -> Iterator[h5py.File]:
    """Open a file for writing in the checksummed format, with `room` bytes reserved.

    HDF5 crashes the whole process (SIGSEGV, without a message) when the disk becomes full during a write. The space is
    therefore reserved in advance, where a full disk is an ordinary OSError: once before HDF5 opens the file, and once
    afterward, because HDF5 truncates the file that it creates.
    """
    import h5py

    _reserve(path, room)
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        _reserve(path, room)
        yield file
        file.flush()
    with open(path, "r+b") as raw:
        raw.seek(END_OF_FILE_ADDRESS)
        raw.truncate(int.from_bytes(raw.read(8), "little"))


@contextmanager
def open_file(path: Path) -> Iterator[h5py.File]:
    """Open a file for reading without a lock, because artifacts are never changed in place.

    Raises:
      ArtifactError: HDF5_USE_FILE_LOCKING demands a lock, and another program has the file open for writing.
    """
    import h5py

    try:
        file = h5py.File(path, "r", locking=False)
    except BlockingIOError as error:
        raise ArtifactError(
            "is locked by another program that has it open for writing: close that program, or unset "
            "HDF5_USE_FILE_LOCKING"
        ) from error
    with file:
        yield file
