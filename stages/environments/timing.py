"""When an episode shows the frames of a video."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Timing:
    """The length of an episode, and the control steps at which it shows the frames of a video.

    Attributes:
        control_steps: Control steps per episode.
        frame_steps: Control step of each of the T frames, increasing; the first is 0, before all actions.
    """

    control_steps: int
    frame_steps: tuple[int, ...]

    @classmethod
    def regular(cls, control_steps: int, frame_every: int) -> Timing:
        """One frame every `frame_every` control steps; the last one may precede the end of the episode."""
        return cls(control_steps, tuple(range(0, control_steps, frame_every)))

    @classmethod
    def spread(cls, control_steps: int, frames: int) -> Timing:
        """`frames` frames spread evenly over the episode; the last one is after its last control step.

        Raises:
            ValueError: There are more frames than control steps.
        """
        if not 2 <= frames <= control_steps + 1:
            raise ValueError(f"{frames} frames do not fit into {control_steps} control steps")
        return cls(control_steps, tuple(round(j * control_steps / (frames - 1)) for j in range(frames)))

    @property
    def frames(self) -> int:
        """Number of frames T."""
        return len(self.frame_steps)

    @property
    def period(self) -> int:
        """Control steps between two frames; the smallest such number if they are not equally spaced."""
        return int(np.diff(self.frame_steps).min()) if self.frames > 1 else self.control_steps

    @cached_property
    def _indices(self) -> dict[int, int]:
        return {step: frame for frame, step in enumerate(self.frame_steps)}

    def frame_at(self, step: int) -> int | None:
        """Index of the frame that is shown after `step` control steps; None: no frame."""
        return self._indices.get(step)

    def last_frames(self) -> np.ndarray:
        """Index of the last frame that was shown at each control step (control steps + 1,)."""
        return np.searchsorted(self.frame_steps, np.arange(self.control_steps + 1), side="right") - 1
