"""HDF5 files of others, read without trusting them: no link is followed, and no data is taken from other files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from artifacts import ArtifactError
from stages.datasets.frames import StoredFrames, as_picture, from_bytes, times_of
from stages.footage.video import SMALLEST

if TYPE_CHECKING:
    import h5py

ENCODED = (b"\xff\xd8", b"\x89PNG")  # how a JPEG and a PNG start
CACHE = 32 * 2**20  # bytes: a chunk of several frames is unpacked once
DEEPEST = 8  # groups in groups


@contextmanager
def opened(path: Path, label: str = "") -> Iterator[h5py.File]:
    """The file, for reading; `label` is what messages name, by default the file.

    Raises:
        ArtifactError: It is truncated or damaged, also where that shows while the block runs.
    """
    import h5py

    try:
        with h5py.File(path, "r", locking=False, rdcc_nbytes=CACHE) as file:
            yield file
    except (OSError, RuntimeError, KeyError) as error:
        reason = " ".join(str(error).split())
        raise ArtifactError(f"{label or path}: is truncated or damaged ({reason}): get the file again") from error


def member(group: h5py.Group, name: str) -> Any:
    """The group or data set of that name, or None.

    Raises:
        ArtifactError: It lies in another file, or there is no telling where.
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
            raise ArtifactError(f"{group.file.filename}: {part} is a link, which is not followed: copy the data in")
        found = found[part]
    if isinstance(found, h5py.Dataset) and (found.external or found.is_virtual):
        raise ArtifactError(f"{group.file.filename}: {name} lies in another file, which is not read: copy the data in")
    return found


def names_in(group: h5py.Group) -> list[str]:
    """Names in a group, but for those that are no text."""
    return [name for name in group if isinstance(name, str)]


def cameras_in(group: h5py.Group, prefix: str = "") -> list[str]:
    """Names of the data sets in and below `group` that hold pictures."""
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
    """Whether it is (T, H, W, C) or (T, C, H, W) of uint8, or a PNG or a JPEG a frame."""
    shape = dataset.shape
    if _is_encoded(dataset):
        return True
    if dataset.dtype != np.uint8 or len(shape) != 4:
        return False
    sides = shape[1:3] if shape[-1] in (1, 3, 4) else shape[2:] if shape[1] in (1, 3) else (0, 0)
    return min(sides) >= SMALLEST


def footage(path: Path, name: str, label: str, expected: int, stamps: np.ndarray | None, rate: float) -> StoredFrames:
    """The pictures of the data set `name` in a file.

    Args:
        path: The file.
        name: Full name of the data set.
        label: How messages name the episode.
        expected: How many frames the file tells of; 0: it does not tell.
        stamps: What the file holds as times; None: nothing.
        rate: Frames a second, from the file; 0: it does not tell.

    Raises:
        ArtifactError: There is no such data set, or it holds no pictures.
    """
    with opened(path, label) as file:
        dataset = member(file, name)
        if dataset is None or not hasattr(dataset, "shape") or not holds_pictures(dataset):
            raise ArtifactError(f"{label}: {name} is not there, or holds no pictures: expected uint8 (T, H, W, 3)")
        count = int(dataset.shape[0])
    cut = f"is truncated, it holds {count} of {expected} frames" if count < expected else ""
    times, notes = times_of(stamps, count, rate, "frame rates are not recorded, and taken as 25 a second")
    return StoredFrames(label, times, partial(_read, path, name, label), cut, notes)


def number(value: Any) -> float:
    """A number above 0, or 0 for anything else."""
    try:
        value = float(value)
    except (TypeError, ValueError, OverflowError):
        return 0.0
    return value if 0 < value < float("inf") else 0.0


def numbers(dataset: Any) -> np.ndarray | None:
    """A small data set of numbers (F,), or None."""
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
