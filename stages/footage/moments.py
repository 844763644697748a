"""Selects the frames to take from a video."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from artifacts import ArtifactError
from stages.footage.footage import Footage

ROUNDING = 5e-4  # seconds; some containers round timestamps to a millisecond


@dataclass(frozen=True)
class Segment:
    """The segment to take from every video.

    Attributes:
        frames: Number of frames, T.
        start: Time of the first frame, seconds from the start of the video.
        end: Time of the last frame, seconds; 0 for the video's last frame.
        fps: Frames per second from the start, instead of an end; 0 to space frames equally up to the end.
    """

    frames: int
    start: float = 0.0
    end: float = 0.0
    fps: float = 0.0


def choose_frames(footage: Footage, wanted: Segment) -> tuple[np.ndarray, int]:
    """Indices (T,) of the frames that a player shows at the wanted times, and how many times are past the end.

    The frame shown at a time is the last one whose timestamp is not later, also with a variable frame rate.

    Raises:
        ArtifactError: The video does not cover the segment, or has only one frame in it.
    """
    label, times, duration = footage.label, footage.times, footage.duration
    if len(times) < 2:
        raise ArtifactError(f"{label}: has only one frame: expected a video")
    if wanted.start >= duration:
        raise ArtifactError(f"{label}: is {duration:.2f} s long, which does not reach --start {wanted.start:g}")
    if wanted.end > duration + ROUNDING:
        raise ArtifactError(f"{label}: is {duration:.2f} s long, less than --end {wanted.end:g}")
    if wanted.fps:
        with np.errstate(over="ignore"):  # Infinity is past the end, too.
            at = wanted.start + np.arange(wanted.frames) / wanted.fps
    else:
        at = np.linspace(wanted.start, wanted.end or max(times[-1], wanted.start), wanted.frames)
    behind = int((at >= duration - ROUNDING).sum()) if wanted.fps else 0
    if footage.cut and (behind or wanted.end > times[-1] + ROUNDING or not (wanted.end or wanted.fps)):
        raise ArtifactError(
            f"{label}: {footage.cut}: get the complete file, or use --end to take a segment up to {times[-1]:.2f} s"
        )
    indices = np.maximum(np.searchsorted(times, at + ROUNDING, side="right") - 1, 0)
    if indices[0] == indices[-1]:
        raise ArtifactError(f"{label}: has only one frame between {at[0]:.2f} and {at[-1]:.2f} s: expected a video")
    return indices, behind
