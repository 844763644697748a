"""Common parts of rewards that are computed from rendered frames of the simulations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from stages.simulation.contexts import Contexts
from stages.simulation.render import RenderPool
from stages.simulation.task import State, Task


class FrameReward(ABC):
    """Base class of rewards of n simulations in one fixed context; renders frames and evaluates them with `judge`.

    The reward is nonzero only at control steps with a frame. The first frame precedes all actions and has no reward.
    There is one term, `return`, unless a subclass adds others. A subclass whose reward changes during learning
    overrides `iterate`, `state` and `restore`.

    Attributes:
        frame_period: Control steps between two frames, and thus between two rewards.
    """

    def __init__(self, task: Task, context: Contexts, pool: RenderPool):
        """Render frames of `task` in `context` (leading axis 1) with `pool`."""
        self._task, self._pool = task, pool
        self.frame_period: int | None = task.frame_every
        self._fields = task.model_fields(context)
        self._sums: dict[str, float] = {}
        self._episodes = 0

    @abstractmethod
    def judge(self, frame: int, drawn: np.ndarray) -> np.ndarray:
        """Rewards (n,) of the simulations' frames (n, H, W, 3), uint8, at frame index `frame` (1, 2, ..., T - 1)."""

    def __call__(self, step: int, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        if step == 1:
            self._episodes += 1
        frame, between = divmod(step, self._task.frame_every)
        if between or frame >= self._task.frames:
            return np.zeros(len(state.qpos))
        reward = self.judge(frame, self._pool.render(self._fields, state.qpos[None])[0])
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

    def close(self) -> None:
        self._pool.close()


def tracking_cost(task: Task, targets: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Targets and cost weights of a `TrackingReward` with reward -weights[j] |z - targets[j]|^2 at frame j.

    Between two frames, the target is that of the previous frame and the cost weight is zero. The first frame also has
    cost weight zero.

    Args:
        task: The task.
        targets: Targets per frame (T, m).
        weights: Weights per frame (T,).

    Returns:
        Targets (control steps + 1, m) and cost weights (control steps + 1,).
    """
    shown = np.minimum(np.arange(task.control_steps + 1) // task.frame_every, task.frames - 1)
    cost_weights = np.zeros(task.control_steps + 1)
    cost_weights[np.arange(1, task.frames) * task.frame_every] = 2 * weights[1:]
    return targets[shown], cost_weights


def time_weights(ramp: str, frames: int) -> np.ndarray:
    """Weights (T,) of frames j in the reward: j^2 scaled to a mean of one if `ramp` is "quadratic", else ones."""
    j = np.arange(frames, dtype=np.float64)
    return j**2 / np.mean(j**2) if ramp == "quadratic" else np.ones_like(j)
