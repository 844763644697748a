"""Individually stored images as footage, independent of the file format."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence

import numpy as np

from artifacts import ArtifactError, image_size
from stages.footage.container import check_size
from stages.footage.images import RATE, decoded

LATEST = 1e12  # seconds; a later time stamp is not one
RATES = 0.01, 10_000  # plausible frames per second
Read = Callable[[np.ndarray], Iterator[np.ndarray]]


class StoredFrames:
    """An episode of images: the times that its file records, and a function that reads the images.

    Attributes:
        label: The name used in messages.
        times: Timestamps (F,), seconds from the first.
        duration: Seconds, including the last frame's duration.
        cut: Description of what is missing; empty if the episode is complete.
        rotation: Always 0.
        damage: Always empty: damaged images are refused.
        notes: Remarks for the user.
    """

    def __init__(self, label: str, times: np.ndarray, read: Read, cut: str = "", notes: Sequence[str] = ()) -> None:
        """Args:
        label: The name used in messages.
        times: Timestamps (F,), seconds, increasing.
        read: Yields the images (H, W, 3) at increasing indices.
        cut: Description of what is missing.
        notes: Remarks for the user.
        """
        self.label, self._read, self.cut = label, read, cut
        self.times = times - times[0] if len(times) else times
        last = float(self.times[-1]) if len(times) else 0.0
        self.duration = last + (float(np.median(np.diff(times))) if len(times) > 1 else 0.0)
        self.rotation, self.damage = 0, ""
        self.notes = list(notes)

    def pictures(self, indices: np.ndarray) -> Generator[tuple[float, np.ndarray], None, None]:
        """Yield time and image (H, W, 3), RGB, uint8, of the frames at these increasing indices.

        Raises:
            ArtifactError: An image is damaged or has an implausible size.
        """
        for index, picture in zip(indices, self._read(indices), strict=True):
            check_size(self.label, picture.shape[1], picture.shape[0])
            yield float(self.times[index]), picture


def times_of(stamps: np.ndarray | None, count: int, rate: float, unknown: str) -> tuple[np.ndarray, list[str]]:
    """Frame times (count,) in seconds, and remarks for the user. Unusable timestamps are replaced by equal steps.

    Args:
        stamps: Timestamps from the file; None if there are none.
        count: Number of frames.
        rate: Frames per second from the file; 0 if not recorded.
        unknown: The remark if the file records neither.
    """
    rate = rate if RATES[0] <= rate <= RATES[1] else 0.0
    notes = []
    if stamps is not None:
        if stamps.shape == (count,) and stamps.dtype.kind in "fiu":
            stamps = stamps.astype(float)
            if (np.abs(stamps) < LATEST).all() and (np.diff(stamps) > 0).all():
                return stamps, []
        notes.append("time stamps that do not increase from frame to frame are replaced by equal steps")
    return np.arange(count) / (rate or RATE), notes + ([] if rate else [unknown])


def as_picture(label: str, array: np.ndarray) -> np.ndarray:
    """Convert a stored image with 1, 3 or 4 channels, first or last, to RGB (H, W, 3).

    Raises:
        ArtifactError: The array is not an image.
    """
    if array.ndim == 3 and array.shape[-1] not in (1, 3, 4) and array.shape[0] in (1, 3):
        array = array.transpose(1, 2, 0)
    if array.ndim != 3 or array.shape[-1] not in (1, 3, 4) or array.dtype != np.uint8:
        raise ArtifactError(f"{label}: a frame is {array.dtype} {array.shape}: expected uint8 (height, width, 3)")
    return np.repeat(array, 3, axis=-1) if array.shape[-1] == 1 else array[..., :3]


def from_bytes(label: str, data: bytes | None) -> np.ndarray:
    """Decode a PNG or JPEG stored in a file to an image (H, W, 3). Its size is checked before it is decoded.

    Raises:
        ArtifactError: The data is not a complete PNG or JPEG, or its image has an implausible size.
    """
    size = image_size(data) if data else None
    if size is not None:
        check_size(label, *size)
    picture = decoded(data) if data and size else None
    if picture is None:
        raise ArtifactError(f"{label}: a frame is not a complete PNG or JPEG: download the dataset again")
    return picture
