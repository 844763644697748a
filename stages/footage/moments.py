"""Which frames of a video are taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from artifacts import ArtifactError
from stages.footage.footage import Footage

ROUNDING = 5e-4  # seconds; some containers round time stamps to a millisecond


@dataclass(frozen=True)
class Segment:
    """What is wanted of every video.

    Attributes:
        frames: T, how many frames.
        start: Where the first is, in seconds from the video's own first frame.
        end: Where the last is, in seconds; 0: at the video's last frame.
        fps: Frames a second from the start, in place of an end; 0: equal times to the end.
    """

    frames: int
    start: float = 0.0
    end: float = 0.0
    fps: float = 0.0


def choose_frames(footage: Footage, wanted: Segment) -> tuple[np.ndarray, int]:
    """Indices (T,) of the frames that a player shows at the wanted times, and how many of these lie behind the end.

    Shown at a time is the last frame whose time stamp is not after it, whatever the frame rate does.

    Raises:
        ArtifactError: The video does not reach over the segment, or shows one frame there.
    """
    label, times, duration = footage.label, footage.times, footage.duration
    if len(times) < 2:
        raise ArtifactError(f"{label}: holds a single frame: expected a video")
    if wanted.start >= duration:
        raise ArtifactError(f"{label}: lasts {duration:.2f} s, which is not beyond --start {wanted.start:g}")
    if wanted.end > duration + ROUNDING:
        raise ArtifactError(f"{label}: lasts {duration:.2f} s, less than --end {wanted.end:g}")
    if wanted.fps:
        at = wanted.start + np.arange(wanted.frames) / wanted.fps
    else:
        at = np.linspace(wanted.start, wanted.end or max(times[-1], wanted.start), wanted.frames)
    behind = int((at >= duration - ROUNDING).sum()) if wanted.fps else 0
    if footage.cut and (behind or wanted.end > times[-1] + ROUNDING or not (wanted.end or wanted.fps)):
        raise ArtifactError(
            f"{label}: {footage.cut}: get the whole file, or take a segment that is there, up to "
            f"{times[-1]:.2f} s, with --end"
        )
    indices = np.maximum(np.searchsorted(times, at + ROUNDING, side="right") - 1, 0)
    if indices[0] == indices[-1]:
        raise ArtifactError(f"{label}: shows a single frame between {at[0]:.2f} and {at[-1]:.2f} s: expected a video")
    return indices, behind
