"""What rewards have in common that look at the simulations' frames."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from stages.simulation.contexts import Contexts
from stages.simulation.render import RenderPool
from stages.simulation.task import State, Task


class FrameReward(ABC):
    """Base of rewards of n simulations in one fixed context; draws their frames and has them judged.

    The reward is given at the control steps whose state a frame shows; the first frame precedes every action and has
    none. One term, unless a subclass reports more; nothing that learning changes, unless it overrides `iterate`,
    `state` and `restore`.

    Attributes:
        frame_period: Control steps between two frames: how often the reward is given.
    """

    def __init__(self, task: Task, context: Contexts, pool: RenderPool):
        """Draw `task` in `context` (leading axis 1)."""
        self._task, self._pool = task, pool
        self.frame_period: int | None = task.frame_every
        self._fields = task.model_fields(context)
        self._sums: dict[str, float] = {}
        self._episodes = 0

    @abstractmethod
    def judge(self, frame: int, drawn: np.ndarray) -> np.ndarray:
        """Reward (n,) of the simulations' frames (n, H, W, 3), uint8, of frame index `frame` (1, 2, ..., T - 1)."""

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
        """Count `values` (n,) towards the mean return of a term."""
        self._sums[term] = self._sums.get(term, 0.0) + float(values.mean())

    def terms(self) -> dict[str, float]:
        means = {name: value / max(self._episodes, 1) for name, value in self._sums.items()}
        self._sums, self._episodes = {}, 0
        return means

    def iterate(self) -> None:  # noqa: B027 - it need not change
        """Change nothing."""

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, state: dict[str, Any]) -> None:  # noqa: B027 - it need not have a state
        """Restore nothing."""

    def close(self) -> None:
        self._pool.close()


def tracking_cost(task: Task, targets: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Targets and cost weights of a `TrackingReward` whose reward of frame j is -weights[j] |z - targets[j]|^2.

    Between two frames the target stays that of the frame last drawn, and costs nothing; nor does the first frame.

    Args:
        task: The task.
        targets: (T, m).
        weights: (T,).

    Returns:
        Targets (control steps + 1, m) and weights (control steps + 1,).
    """
    shown = np.minimum(np.arange(task.control_steps + 1) // task.frame_every, task.frames - 1)
    cost_weights = np.zeros(task.control_steps + 1)
    cost_weights[np.arange(1, task.frames) * task.frame_every] = 2 * weights[1:]
    return targets[shown], cost_weights


def time_weights(ramp: str, frames: int) -> np.ndarray:
    """Weights (T,) of a video's frames in the reward: j^2, scaled to a mean of one, or ones."""
    j = np.arange(frames, dtype=np.float64)
    return j**2 / np.mean(j**2) if ramp == "quadratic" else np.ones_like(j)
