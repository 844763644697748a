"""One episode of a video file that holds several episodes."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from contextlib import closing

import numpy as np

from artifacts import ArtifactError
from stages.footage.video import VideoFile

HALF = 0.5  # frames that a duration may differ from a length
PERIODS = 1000  # frames at the beginning of a file that give its frame rate
LEAST, SHARE = 2, 0.02  # tolerated disagreement of a table about a length, in frames and as a fraction


class VideoWindow:
    """The frames of a video file between two times.

    Attributes:
        label: The name used in messages.
        times: Timestamps (F,), seconds from the first.
        duration: Seconds, including the last frame's duration.
        cut: Description of what is missing; empty if the episode is complete.
    """

    def __init__(self, label: str, video: VideoFile, first: int, expected: int, notes: Sequence[str] = ()) -> None:
        """Args:
        label: The name used in messages.
        video: The file.
        first: Index of the first frame, which the file has.
        expected: Number of frames. If the file ends before them, the episode is cut.
        notes: Remarks for the user.
        """
        self.label, self._video, self._first, self._notes = label, video, first, list(notes)
        self.times = video.times[first : first + expected] - video.times[first]
        self.duration = float(self.times[-1]) + (period_of(video) or video.duration)
        lacking = expected - len(self.times)
        self.cut = f"is truncated to {len(self.times)} of {expected} frames" if lacking > slack(expected) else ""
        if lacking > 0 and not self.cut:
            self._notes.append("videos are one or two frames shorter than their tables state")

    @property
    def rotation(self) -> int:
        """Counterclockwise rotation applied to images, degrees; known after the first image was read."""
        return self._video.rotation

    @property
    def damage(self) -> str:
        """Description of the damage that has reached the images read last; empty if none has."""
        return self._video.damage

    @property
    def notes(self) -> list[str]:
        """Remarks for the user, collected while reading."""
        return self._notes + self._video.notes

    def pictures(self, indices: np.ndarray) -> Generator[tuple[float, np.ndarray], None, None]:
        """Yield time and image (H, W, 3), RGB, uint8, of the frames at these increasing indices.

        Raises:
            ArtifactError: A frame cannot be decoded.
        """
        with closing(self._video.pictures(np.asarray(indices) + self._first)) as pictures:
            for index, (_, picture) in zip(indices, pictures, strict=True):
                yield float(self.times[index]), picture


def between(
    label: str, video: VideoFile, begin: float, end: float, length: int, notes: Sequence[str] = ()
) -> VideoWindow:
    """The frames of a video file between two times.

    Args:
        label: The name used in messages.
        video: The file.
        begin: Timestamp of the first frame, seconds.
        end: Timestamp of the first frame after the episode, seconds.
        length: Number of frames; 0 if unknown.
        notes: Remarks for the user.

    Raises:
        ArtifactError: The file ends before the episode, or the times and the length contradict each other.
    """
    period = period_of(video) or max(end - begin, 0.0) or 1.0
    lasting = (end - begin) / period
    if not 0 < lasting < float("inf") or (length and abs(lasting - length) > HALF):
        raise ArtifactError(
            f"{label}: spans {begin:g} to {end:g} s but has {length} frames: its tables are damaged; download the "
            "dataset again"
        )
    first = max(nearest(video, begin), 0)
    if first >= len(video.times):
        ends = video.begins + float(video.times[-1]) + period
        raise ArtifactError(f"{video.label}: ends at {ends:.2f} s, before {label}: download it again")
    return VideoWindow(label, video, first, length or max(round(lasting), 1), notes)


def nearest(video: VideoFile, time: float) -> int:
    """Index of the frame whose timestamp is nearest to a time, continued beyond the file; -1 if there is no time.

    In long files, the sum of durations drifts by a fraction of a frame.
    """
    if not math.isfinite(time):
        return -1
    period, time = period_of(video) or 1.0, time - video.begins  # The first timestamp is now 0.
    last = float(video.times[-1])
    if not math.isfinite((abs(time) + last) / period):  # No number of frames is as large.
        return -1
    if time < -period / 2:
        return min(round(time / period), -1)
    if time > last + period / 2:
        return len(video.times) - 1 + max(round((time - last) / period), 1)
    return int(np.searchsorted(video.times, time - period / 2))


def period_of(video: VideoFile) -> float:
    """Seconds between two frames, as at the beginning of the file; 0 for a single frame."""
    return float(np.median(np.diff(video.times[:PERIODS]))) if len(video.times) > 1 else 0.0


def slack(length: int) -> float:
    """Tolerance of a frame count, in frames."""
    return max(LEAST, SHARE * length)
