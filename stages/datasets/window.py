"""A part of a video file, of which many episodes lie in one."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing

import numpy as np

from artifacts import ArtifactError
from stages.footage.video import VideoFile

LEAST, SHARE = 2, 0.02  # frames, or share of them, by which a table may disagree with itself about a length


class VideoWindow:
    """The frames of a video file from one time to another.

    Attributes:
        label: How messages name it.
        times: Time stamps (F,), seconds from the first.
        duration: Seconds, the last frame's included.
        cut: In words, what it lacks; empty for a whole one.
    """

    def __init__(
        self, label: str, video: VideoFile, begin: float, end: float, length: int, notes: Sequence[str] = ()
    ) -> None:
        """Find the frames.

        Args:
            label: How messages name it.
            video: The file.
            begin: Time stamp of the first frame, seconds.
            end: That of the first one after it.
            length: Number of frames; 0: unknown.
            notes: What people should know.

        Raises:
            ArtifactError: The file ends before, or the times and the length contradict each other.
        """
        self.label, self._video, self._notes = label, video, list(notes)
        stamps = video.begins + video.times
        period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else max(end - begin, 0.0)
        # The nearest frame: in long files sums of durations drift off by part of a frame.
        first, told = (int(np.searchsorted(stamps, at - period / 2)) for at in (begin, end))
        if not begin < end or (length and abs(round((end - begin) / (period or 1)) - length) > slack(length)):
            raise ArtifactError(
                f"{label}: lasts from {begin:g} to {end:g} s, but has {length} frames: its tables are damaged"
            )
        last = min(first + (length or told - first), len(stamps))
        if last <= first:
            raise ArtifactError(f"{video.label}: ends at {stamps[-1] + period:.2f} s, before {label}: get it again")
        self._first = first
        self.times = stamps[first:last] - stamps[first]
        self.duration = float(self.times[-1]) + period
        expected = length or round((end - begin) / (period or 1))
        lacking = expected - len(self.times)
        self.cut = f"is truncated, it holds {len(self.times)} of {expected} frames" if lacking > slack(expected) else ""
        if lacking > 0 and not self.cut:
            self._notes.append("videos are a frame or two shorter than their tables say")

    @property
    def rotation(self) -> int:
        """Degrees that pictures are turned by, anticlockwise; known once one was read."""
        return self._video.rotation

    @property
    def notes(self) -> list[str]:
        """What people should know, gathered while reading."""
        return self._notes + self._video.notes

    def pictures(self, indices: np.ndarray) -> Generator[tuple[float, np.ndarray], None, None]:
        """Time and picture (H, W, 3), RGB, uint8, of the frames at these increasing indices.

        Raises:
            ArtifactError: One of them cannot be decoded.
        """
        with closing(self._video.pictures(np.asarray(indices) + self._first)) as pictures:
            for index, (_, picture) in zip(indices, pictures, strict=True):
                yield float(self.times[index]), picture


def slack(length: int) -> float:
    """Frames by which a number of frames may be off."""
    return max(LEAST, SHARE * length)
