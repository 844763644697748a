"""Pictures that lie in a file one by one, in whatever way, as footage."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence

import numpy as np

from artifacts import ArtifactError
from stages.footage.images import RATE, decoded
from stages.footage.video import check_size

Read = Callable[[np.ndarray], Iterator[np.ndarray]]


class StoredFrames:
    """An episode of pictures: what its file says of their times, and a function that reads them.

    Attributes:
        label: How messages name it.
        times: Time stamps (F,), seconds from the first.
        duration: Seconds, the last frame's included.
        cut: In words, what it lacks; empty for a whole one.
        rotation: 0.
        notes: What people should know.
    """

    def __init__(self, label: str, times: np.ndarray, read: Read, cut: str = "", notes: Sequence[str] = ()) -> None:
        """Args:
        label: How messages name it.
        times: Time stamps (F,), seconds, increasing.
        read: Yields the pictures (H, W, 3) at increasing indices.
        cut: In words, what it lacks.
        notes: What people should know.
        """
        self.label, self._read, self.cut = label, read, cut
        self.times = times - times[0] if len(times) else times
        last = float(self.times[-1]) if len(times) else 0.0
        self.duration = last + (float(np.median(np.diff(times))) if len(times) > 1 else 0.0)
        self.rotation = 0
        self.notes = list(notes)

    def pictures(self, indices: np.ndarray) -> Generator[tuple[float, np.ndarray], None, None]:
        """Time and picture (H, W, 3), RGB, uint8, of the frames at these increasing indices.

        Raises:
            ArtifactError: One of them is damaged, or of an absurd size.
        """
        for index, picture in zip(indices, self._read(indices), strict=True):
            check_size(self.label, picture.shape[1], picture.shape[0])
            yield float(self.times[index]), picture


def times_of(stamps: np.ndarray | None, count: int, rate: float, unknown: str) -> tuple[np.ndarray, list[str]]:
    """Times (count,) in seconds: the stamps where they are usable, else equal steps; and what there is to say of it.

    Args:
        stamps: What the file holds as times; None: nothing.
        count: Number of frames.
        rate: Frames a second, from the file; 0: it does not tell.
        unknown: What to say where the file tells neither.
    """
    if stamps is not None and stamps.shape == (count,) and stamps.dtype.kind in "fiu":
        stamps = stamps.astype(float)
        if np.isfinite(stamps).all() and (np.diff(stamps) > 0).all():
            return stamps, []
    return np.arange(count) / (rate or RATE), [] if rate else [unknown]


def as_picture(label: str, array: np.ndarray) -> np.ndarray:
    """A stored picture, of 1, 3 or 4 channels which lie last or first, as RGB (H, W, 3).

    Raises:
        ArtifactError: It is none.
    """
    if array.ndim == 3 and array.shape[-1] not in (1, 3, 4) and array.shape[0] in (1, 3):
        array = array.transpose(1, 2, 0)
    if array.ndim != 3 or array.shape[-1] not in (1, 3, 4) or array.dtype != np.uint8:
        raise ArtifactError(f"{label}: a frame is {array.dtype} {array.shape}: expected uint8 of (height, width, 3)")
    return np.repeat(array, 3, axis=-1) if array.shape[-1] == 1 else array[..., :3]


def from_bytes(label: str, data: bytes | None) -> np.ndarray:
    """The picture (H, W, 3) that a PNG or a JPEG in a file holds.

    Raises:
        ArtifactError: It is none.
    """
    picture = decoded(data) if data else None
    if picture is None:
        raise ArtifactError(f"{label}: a frame is no whole PNG or JPEG: get the data set again")
    return picture
