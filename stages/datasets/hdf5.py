"""Reads untrusted HDF5 files: links are not followed and no data is read from other files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from artifacts import ArtifactError
from stages.datasets.episode import check_is_there, is_plain, reason_of
from stages.datasets.frames import StoredFrames, as_picture, from_bytes, times_of
from stages.datasets.hdf5_chunks import LARGEST_CHUNK, StoredArray
from stages.datasets.hdf5_heaps import check_heaps
from stages.footage.container import SMALLEST, check_size

if TYPE_CHECKING:
    import h5py

ENCODED = (b"\xff\xd8", b"\x89PNG")  # leading bytes of JPEG and PNG
CACHE = 32 * 2**20  # bytes, so that a chunk of several frames is decompressed only once
DEEPEST = 8  # maximum nesting of groups
MOST_NAMES = 100_000  # members of a group
LARGEST_COUNT = 10**9  # frames
UNKNOWN_RATE = "no frame rate is recorded; 25 frames per second are assumed"
OTHER_LENGTH = "the number of frames differs from what the file states elsewhere; all frames are read"
# What h5py raises for damaged files, and for types that NumPy does not have.
REFUSALS = (OSError, RuntimeError, KeyError, TypeError, ValueError, OverflowError, AttributeError, IndexError)


@contextmanager
def opened(path: Path, label: str = "") -> Iterator[h5py.File]:
    """Open the file for reading. Messages name `label`, by default the path.

    Raises:
        ArtifactError: The file is truncated or damaged, even if that is detected only while the block runs.
    """
    import h5py

    name = label or path
    try:
        check_is_there(path)
        check_heaps(path)
        with h5py.File(path, "r", locking=False, rdcc_nbytes=CACHE) as file:
            yield file
    except BlockingIOError as error:
        raise ArtifactError(
            f"{name}: is locked by another program that has it open for writing: close that program, or unset "
            "HDF5_USE_FILE_LOCKING"
        ) from error
    except MemoryError as error:
        raise ArtifactError(f"{name}: does not fit in memory: free some memory, or download it again") from error
    except REFUSALS as error:
        raise ArtifactError(f"{name}: is truncated or damaged ({reason_of(error)}): download it again") from error


def member(group: h5py.Group, name: str) -> Any:
    """Return the group or dataset with this name, or None.

    Raises:
        ArtifactError: The name is a link, or the data is stored in another file.
    """
    import h5py

    found: Any = group
    for part in name.split("/"):
        if not isinstance(found, h5py.Group):
            return None
        links, link = found.id.links, part.encode("utf-8", "surrogateescape")
        if not links.exists(link):
            return None
        if links.get_info(link).type != h5py.h5l.TYPE_HARD:
            raise ArtifactError(
                f"{group.file.filename}: {part} is a link, and links are not followed: copy the data into the file"
            )
        found = found[part]
    if isinstance(found, h5py.Dataset) and (found.external or found.is_virtual):
        raise ArtifactError(
            f"{group.file.filename}: {name} is stored in another file, which is not read: copy the data into the file"
        )
    return found


def names_in(group: h5py.Group) -> list[str]:
    """Names in a group, except those that are not printable text.

    Raises:
        ArtifactError: There are implausibly many.
    """
    if len(group) > MOST_NAMES:
        raise ArtifactError(f"{group.file.filename}: a group has {len(group)} members: expected at most {MOST_NAMES}")
    return [name for name in group if is_plain(name)]


def cameras_in(group: h5py.Group) -> list[str]:
    """Names of the datasets in and below `group` that hold images."""
    return list(_cameras_below(group, "", set()))


def _cameras_below(group: h5py.Group, prefix: str, seen: set[int]) -> Iterator[str]:
    import h5py

    seen.add(h5py.h5o.get_info(group.id).addr)  # A group may contain itself, under any number of names.
    for name in names_in(group):
        item = member(group, name)
        if isinstance(item, h5py.Dataset) and holds_pictures(item):
            yield f"{prefix}{name}"
        elif not isinstance(item, h5py.Group) or prefix.count("/") >= DEEPEST:
            continue
        elif h5py.h5o.get_info(item.id).addr not in seen:
            yield from _cameras_below(item, f"{prefix}{name}/", seen)


def holds_pictures(dataset: Any) -> bool:
    """Whether this is a dataset of uint8 (T, H, W, C) or (T, C, H, W), or one PNG or JPEG per frame."""
    import h5py

    if not isinstance(dataset, h5py.Dataset) or not dataset.shape:
        return False
    try:
        return min(_sides(dataset)) >= SMALLEST or _is_encoded(dataset)
    except (ArtifactError, *REFUSALS):  # Of a type that NumPy does not have, or damaged.
        return False


def _sides(dataset: h5py.Dataset) -> tuple[int, int]:
    """Height and width of the images in an array; zeros if it does not contain images."""
    shape = dataset.shape
    if dataset.dtype != np.uint8 or len(shape) != 4:
        return 0, 0
    return shape[1:3] if shape[-1] in (1, 3, 4) else shape[2:] if shape[1] in (1, 3) else (0, 0)


def footage(path: Path, name: str, label: str, expected: Sequence[int], times: str, rate: float) -> StoredFrames:
    """The images of the dataset `name` in a file.

    Args:
        path: The file.
        name: Full name of the dataset.
        label: The episode's name in messages.
        expected: Numbers of frames that parts of the file declare. One that is reached is enough, because the others
            may be wrong.
        times: Full name of the dataset of timestamps, if there is one.
        rate: Frames per second from the file; 0 if not recorded.

    Raises:
        ArtifactError: The dataset does not exist, is incomplete, or contains no images.
    """
    import h5py

    with opened(path, label) as file:
        dataset = member(file, name)
        if not holds_pictures(dataset):
            if isinstance(dataset, h5py.Dataset) and dataset.shape:
                StoredArray(label, dataset)  # Says what is missing.
            raise ArtifactError(f"{label}: {name} is missing or contains no images: expected uint8 (T, H, W, 3)")
        StoredArray(label, dataset)
        if min(sides := _sides(dataset)):
            check_size(label, sides[1], sides[0])
        count = int(dataset.shape[0])
        stamps = _numbers(label, member(file, times), count)
    if not count:
        raise ArtifactError(f"{label}: has no frames: expected a video")
    declared = {number for number in expected if number}
    lacking = bool(declared) and count < min(declared)
    cut = f"is truncated to {count} of {max(declared)} frames" if lacking else ""
    notes = [OTHER_LENGTH] if not lacking and declared - {count} else []
    moments, said = times_of(stamps, count, rate, UNKNOWN_RATE)
    return StoredFrames(label, moments, partial(_read, path, name, label), cut, notes + said)


def number(value: Any) -> float:
    """`value` as a float if it is a positive finite number, or an array of one; else 0."""
    try:
        value = float(value.item() if isinstance(value, np.ndarray) else value)
    except (TypeError, ValueError, OverflowError):
        return 0.0
    return value if 0 < value < float("inf") else 0.0


def whole_number(value: Any) -> int:
    """`value` as an integer if it is a plausible number of frames, else 0."""
    found = number(value)
    return int(found) if found.is_integer() and found < LARGEST_COUNT else 0


def length_of(item: Any) -> int:
    """Length of a dataset's first axis; 0 if this is not a dataset with axes."""
    import h5py

    return int(item.shape[0]) if isinstance(item, h5py.Dataset) and item.shape else 0


def _numbers(label: str, item: Any, count: int) -> np.ndarray | None:
    """The values (count,) of a numeric dataset; empty if it has another shape or type; None if it is not there."""
    import h5py

    if item is None:
        return None
    if not isinstance(item, h5py.Dataset) or item.shape != (count,) or item.dtype.kind not in "fiu":
        return np.empty(0)
    return StoredArray(label, item).whole()


def _read(path: Path, name: str, label: str, indices: np.ndarray) -> Iterator[np.ndarray]:
    with opened(path, label) as file:
        dataset = member(file, name)
        encoded, array = _is_encoded(dataset), StoredArray(label, dataset)
        for index in indices:
            item = array[int(index)]
            yield from_bytes(label, item.tobytes()) if encoded else as_picture(label, item)


def _is_encoded(dataset: h5py.Dataset) -> bool:
    """Whether the dataset (T,) of byte arrays or (T, bytes) contains one PNG or JPEG per frame."""
    import h5py

    shape = dataset.shape
    of_bytes = h5py.check_vlen_dtype(dataset.dtype) == np.uint8 if len(shape) == 1 else False
    fixed = len(shape) == 2 and dataset.dtype == np.uint8 and shape[1] <= LARGEST_CHUNK
    if not (of_bytes or fixed) or not shape[0]:
        return False
    return StoredArray("", dataset)[0][:4].tobytes().startswith(ENCODED)
