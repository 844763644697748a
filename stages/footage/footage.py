"""The interface that all kinds of footage share, whatever the storage format."""

from __future__ import annotations

from collections.abc import Generator
from typing import Protocol

import numpy as np


class Footage(Protocol):
    """An open video: its timestamps, and its images on demand."""

    @property
    def label(self) -> str:
        """The name used in messages."""

    @property
    def times(self) -> np.ndarray:
        """Timestamps (F,) of all frames, seconds from the first, increasing."""

    @property
    def duration(self) -> float:
        """Seconds, including the last frame's duration."""

    @property
    def cut(self) -> str:
        """Description of what is missing from a truncated video; empty if it is complete."""

    @property
    def rotation(self) -> int:
        """Counterclockwise rotation applied to images, degrees; known after the first image was read."""

    @property
    def damage(self) -> str:
        """Description of the damage that has reached the images read last; empty if none has."""

    @property
    def notes(self) -> list[str]:
        """Remarks for the user, collected while reading."""

    def pictures(self, indices: np.ndarray) -> Generator[tuple[float, np.ndarray], None, None]:
        """Yield time and image (H, W, 3), RGB, uint8, of the frames at these increasing indices.

        Raises:
            ArtifactError: A frame cannot be decoded.
        """
