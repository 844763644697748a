"""What is written as a data set of another library."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

Videos = Callable[[], Iterator[tuple[np.ndarray, np.ndarray]]]


@dataclass(frozen=True)
class Export:
    """Demonstrations on their way out. There are no actions in them, nor rewards, and contexts stay behind.

    Attributes:
        shape: N, T, H, W of the demonstrations.
        videos: Goes through them: frames (T, H, W, 3), uint8, and their times (T,) in seconds.
        camera: What the camera is called.
        task: What is done, in words.
        fps: Frames a second that the data set claims.
        video: LeRobot's pictures as H.264, in place of PNGs in its tables.
        crf: x264's constant rate factor.
        origin: Where they come from, for people: names -> text.
    """

    shape: tuple[int, int, int, int]
    videos: Videos
    camera: str
    task: str
    fps: int
    video: bool
    crf: int
    origin: dict[str, str]
