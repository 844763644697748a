"""The demonstrations and metadata that an export writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

Videos = Callable[[], Iterator[tuple[np.ndarray, np.ndarray]]]


@dataclass(frozen=True)
class Export:
    """Demonstrations to export. They contain no actions and no rewards, and contexts are not exported.

    Attributes:
        shape: N, T, H, W of the demonstrations.
        videos: Iterates over the demonstrations: frames (T, H, W, 3), uint8, and their times (T,) in seconds.
        camera: Name of the camera.
        task: Description of the task in words.
        fps: Frames per second that the dataset declares.
        video: Whether LeRobot's images are stored as H.264 instead of as PNGs in its tables.
        crf: x264's constant rate factor.
        origin: Where the demonstrations come from, for human readers: name -> text.
    """

    shape: tuple[int, int, int, int]
    videos: Videos
    camera: str
    task: str
    fps: int
    video: bool
    crf: int
    origin: dict[str, str]
