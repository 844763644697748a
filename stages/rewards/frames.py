"""Common parts of rewards that are computed from the frames that environments show."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from stages.environments.protocol import Moment
from stages.environments.timing import Timing


class FrameReward(ABC):
    """Base class of rewards of n environments in one fixed context; evaluates their frames with `judge`.

    The reward is nonzero only at control steps with a frame. The first frame precedes all actions and has no reward.
    There is one term, `return`, unless a subclass adds others. A subclass whose reward changes during learning
    overrides `iterate`, `state` and `restore`.

    Attributes:
        frame_period: Control steps between two frames, and thus between two rewards.
    """

    def __init__(self, timing: Timing):
        """Judge the frames that episodes with this `timing` show."""
        self._timing = timing
        self.frame_period: int | None = timing.period
        self._sums: dict[str, float] = {}
        self._episodes = 0

    @abstractmethod
    def judge(self, frame: int, drawn: np.ndarray) -> np.ndarray:
        """Rewards (n,) of the environments' frames (n, H, W, 3), uint8, at frame index `frame` (1, 2, ..., T - 1)."""

    def __call__(self, moment: Moment, action: np.ndarray) -> np.ndarray:
        if moment.step == 1:
            self._episodes += 1
        frame = self._timing.frame_at(moment.step)
        if frame is None:
            return np.zeros(len(moment.observation))
        reward = self.judge(frame, moment.frames())
        self.add("return", reward)
        return reward

    def add(self, term: str, values: np.ndarray) -> None:
        """Add the mean of `values` (n,) to the return of a term."""
        self._sums[term] = self._sums.get(term, 0.0) + float(values.mean())

    def terms(self) -> dict[str, float]:
        means = {name: value / max(self._episodes, 1) for name, value in self._sums.items()}
        self._sums, self._episodes = {}, 0
        return means

    def iterate(self) -> None:  # noqa: B027 - optional for subclasses
        """No-op."""

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, state: dict[str, Any]) -> None:  # noqa: B027 - optional for subclasses
        """No-op, because there is no state."""

    def close(self) -> None:  # noqa: B027 - optional for subclasses
        """No-op, because there are no resources to free."""


def tracking_cost(timing: Timing, targets: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Targets and cost weights of a `TrackingReward` with reward -weights[j] |z - targets[j]|^2 at frame j.

    Between two frames, the target is that of the previous frame and the cost weight is zero. The first frame also has
    cost weight zero.

    Args:
        timing: When episodes show frames.
        targets: Targets per frame (T, m).
        weights: Weights per frame (T,).

    Returns:
        Targets (control steps + 1, m) and cost weights (control steps + 1,).
    """
    cost_weights = np.zeros(timing.control_steps + 1)
    cost_weights[list(timing.frame_steps[1:])] = 2 * weights[1:]
    return targets[timing.last_frames()], cost_weights


def time_weights(ramp: str, frames: int) -> np.ndarray:
    """Weights (T,) of frames j in the reward: j^2 scaled to a mean of one if `ramp` is "quadratic", else ones."""
    j = np.arange(frames, dtype=np.float64)
    return j**2 / np.mean(j**2) if ramp == "quadratic" else np.ones_like(j)
