"""Individually stored images as footage, independent of the file format."""

from __future__ import annotations

import struct
from collections.abc import Callable, Generator, Iterator, Sequence

import numpy as np

from artifacts import ArtifactError
from stages.footage.images import RATE, decoded
from stages.footage.video import check_size

MOST_PIXELS = 2**26  # of an image; a decoder needs up to eight bytes for each
PNG_HEADER = struct.Struct(">8x4x4sII")  # signature, length, the type of the first chunk, width, height
JPEG_SEGMENT = struct.Struct(">BBHxHH")  # 0xFF, type, length, bits per sample, height, width
JPEG_SIZES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # types of the segments that record the size
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
            check_picture_size(self.label, picture.shape[1], picture.shape[0])
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
    size = size_in_header(data) if data else None
    if size is not None:
        check_picture_size(label, *size)
    picture = decoded(data) if data and size else None
    if picture is None:
        raise ArtifactError(f"{label}: a frame is not a complete PNG or JPEG: download the dataset again")
    return picture


def check_picture_size(label: str, width: int, height: int) -> None:
    """Raise ArtifactError for image sizes that no camera produces."""
    check_size(label, width, height)
    if width * height > MOST_PIXELS:
        raise ArtifactError(f"{label}: its image has {width}x{height} pixels: expected at most {MOST_PIXELS}")


def size_in_header(data: bytes) -> tuple[int, int] | None:
    """Width and height according to the header of a PNG or JPEG; None if it has none."""
    if data.startswith(b"\x89PNG"):
        if len(data) < PNG_HEADER.size:
            return None
        kind, width, height = PNG_HEADER.unpack_from(data)
        return (width, height) if kind == b"IHDR" else None
    at = 2
    while data.startswith(b"\xff\xd8") and at + JPEG_SEGMENT.size <= len(data):
        mark, kind, length, height, width = JPEG_SEGMENT.unpack_from(data, at)
        if mark != 0xFF:
            return None
        if kind in JPEG_SIZES:
            return width, height
        at += 1 if kind == 0xFF else 2 + length  # 0xFF pads
    return None
