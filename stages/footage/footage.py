"""What every kind of footage offers, whatever it is stored as."""

from __future__ import annotations

from collections.abc import Generator
from typing import Protocol

import numpy as np


class Footage(Protocol):
    """A video that is open: its time stamps, and its pictures on demand."""

    @property
    def label(self) -> str:
        """How messages name it."""

    @property
    def times(self) -> np.ndarray:
        """Time stamps (F,) of all frames, seconds from the first, increasing."""

    @property
    def duration(self) -> float:
        """Seconds, the last frame's included."""

    @property
    def cut(self) -> str:
        """In words, what a truncated one lacks; empty for a whole one."""

    @property
    def rotation(self) -> int:
        """Degrees that pictures are turned by, anticlockwise; known once one was read."""

    @property
    def notes(self) -> list[str]:
        """What people should know, gathered while reading."""

    def pictures(self, indices: np.ndarray) -> Generator[tuple[float, np.ndarray], None, None]:
        """Time and picture (H, W, 3), RGB, uint8, of the frames at these increasing indices.

        Raises:
            ArtifactError: One of them cannot be decoded.
        """
