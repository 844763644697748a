"""Reads untrusted HDF5 files: links are not followed and no data is read from other files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from artifacts import ArtifactError
from stages.datasets.frames import StoredFrames, as_picture, from_bytes, times_of
from stages.footage.container import SMALLEST

if TYPE_CHECKING:
    import h5py

ENCODED = (b"\xff\xd8", b"\x89PNG")  # leading bytes of JPEG and PNG
CACHE = 32 * 2**20  # bytes, so that a chunk of several frames is decompressed only once
DEEPEST = 8  # maximum nesting of groups


@contextmanager
def opened(path: Path, label: str = "") -> Iterator[h5py.File]:
    """Open the file for reading. Messages name `label`, by default the path.

    Raises:
        ArtifactError: The file is truncated or damaged, even if that is detected only while the block runs.
    """
    import h5py

    try:
        with h5py.File(path, "r", locking=False, rdcc_nbytes=CACHE) as file:
            yield file
    except (OSError, RuntimeError, KeyError) as error:
        reason = " ".join(str(error).split())
        raise ArtifactError(f"{label or path}: is truncated or damaged ({reason}): download it again") from error


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
    """Names in a group, except those that are not valid text."""
    return [name for name in group if isinstance(name, str)]


def cameras_in(group: h5py.Group, prefix: str = "") -> list[str]:
    """Names of the datasets in and below `group` that hold images."""
    import h5py

    found = []
    for name in names_in(group):
        item = member(group, name)
        if isinstance(item, h5py.Group) and prefix.count("/") < DEEPEST:
            found += cameras_in(item, f"{prefix}{name}/")
        elif isinstance(item, h5py.Dataset) and holds_pictures(item):
            found.append(f"{prefix}{name}")
    return found


def holds_pictures(dataset: h5py.Dataset) -> bool:
    """Whether the dataset is uint8 (T, H, W, C) or (T, C, H, W), or one PNG or JPEG per frame."""
    shape = dataset.shape
    if _is_encoded(dataset):
        return True
    if dataset.dtype != np.uint8 or len(shape) != 4:
        return False
    sides = shape[1:3] if shape[-1] in (1, 3, 4) else shape[2:] if shape[1] in (1, 3) else (0, 0)
    return min(sides) >= SMALLEST


def footage(path: Path, name: str, label: str, expected: int, stamps: np.ndarray | None, rate: float) -> StoredFrames:
    """The images of the dataset `name` in a file.

    Args:
        path: The file.
        name: Full name of the dataset.
        label: The episode's name in messages.
        expected: Number of frames that the file declares; 0 if not recorded.
        stamps: Timestamps from the file; None if there are none.
        rate: Frames per second from the file; 0 if not recorded.

    Raises:
        ArtifactError: The dataset does not exist or contains no images.
    """
    with opened(path, label) as file:
        dataset = member(file, name)
        if dataset is None or not hasattr(dataset, "shape") or not holds_pictures(dataset):
            raise ArtifactError(f"{label}: {name} is missing or contains no images: expected uint8 (T, H, W, 3)")
        count = int(dataset.shape[0])
    cut = f"is truncated to {count} of {expected} frames" if count < expected else ""
    times, notes = times_of(stamps, count, rate, "no frame rate is recorded; 25 frames per second are assumed")
    return StoredFrames(label, times, partial(_read, path, name, label), cut, notes)


def number(value: Any) -> float:
    """`value` as a float if it is a positive finite number, else 0."""
    try:
        value = float(value)
    except (TypeError, ValueError, OverflowError):
        return 0.0
    return value if 0 < value < float("inf") else 0.0


def numbers(dataset: Any) -> np.ndarray | None:
    """The values (F,) of a numeric dataset, or None."""
    if dataset is None or not hasattr(dataset, "shape") or len(dataset.shape) != 1 or dataset.dtype.kind not in "fiu":
        return None
    return np.asarray(dataset[...])


def _read(path: Path, name: str, label: str, indices: np.ndarray) -> Iterator[np.ndarray]:
    with opened(path, label) as file:
        dataset = member(file, name)
        encoded = _is_encoded(dataset)
        for index in indices:
            array = np.asarray(dataset[int(index)])
            yield from_bytes(label, array.tobytes()) if encoded else as_picture(label, array)


def _is_encoded(dataset: h5py.Dataset) -> bool:
    import h5py

    of_bytes = h5py.check_vlen_dtype(dataset.dtype) == np.uint8 if len(dataset.shape) == 1 else False
    fixed = len(dataset.shape) == 2 and dataset.dtype == np.uint8
    if not (of_bytes or fixed) or not dataset.shape[0]:
        return False
    return np.asarray(dataset[0])[:4].tobytes().startswith(ENCODED)
