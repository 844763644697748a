"""Rewards that read the simulator's state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from stages.simulation.contexts import Contexts
from stages.simulation.task import State, Task


class StateReward(ABC):
    """Base of rewards that read the simulator's state: one term, nothing to free."""

    frame_period: int | None = None  # No frames: the reward sees every state.

    def __init__(self, task: Task):
        self._task = task
        self._returns: list[np.ndarray] = []

    @abstractmethod
    def reward(self, step: int, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        """Reward (n,) of the action (n, nu) that led to `state`."""

    def __call__(self, step: int, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        value = self.reward(step, state, action, contexts)
        self._returns.append(value)
        return value

    def terms(self) -> dict[str, float]:
        episodes = max(len(self._returns) // self._task.control_steps, 1)
        total = float(np.mean(np.sum(self._returns, axis=0))) / episodes if self._returns else 0.0
        self._returns.clear()
        return {"return": total}

    def iterate(self) -> None:  # noqa: B027 - it never changes
        """Change nothing."""

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, state: dict[str, Any]) -> None:  # noqa: B027 - it has no state
        """Restore nothing."""

    def close(self) -> None:  # noqa: B027 - nothing to free here, and nothing to demand of subclasses
        """Free nothing."""


class ExpertReward(StateReward):
    """The task's hand-written reward, that the experts learn from."""

    def reward(self, step: int, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        return self._task.expert_reward(state, action, contexts)


class OracleReward(StateReward):
    """The paper's oracle: the negative distance over the initial one, at the last step only (Sec. VI.B)."""

    def __init__(self, task: Task):
        super().__init__(task)
        self._distances: list[np.ndarray] = []

    def reward(self, step: int, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        distance = self._task.distance(state, contexts)
        if step == 1:
            # The start itself is not seen here: one control step later stands for it.
            self._distances = [distance]
        self._distances.append(distance)
        if step < self._task.control_steps:
            return np.zeros(len(state.qpos))
        initial, final = self._task.outcome(np.stack(self._distances, axis=1))
        return -final / initial


class GoalReward(OracleReward):
    """The oracle for a learner of quadratic costs: beside its return, the task's error as a vector, to track zero.

    The cost is half the squared error over that of the context's own start, at every control step. A quadratic cost in
    the last step alone would leave the way there to the penalty on actions.
    """

    def __init__(self, task: Task, contexts: Contexts):
        """Measure the start of `contexts` (leading axis 1).

        Raises:
            UsageError: The task defines no error.
        """
        from stages.simulation.batch import BatchSimulation

        super().__init__(task)
        start = BatchSimulation(task, 1, 1).reset(*task.context_state(contexts))
        error = task.goal_error(start, contexts)
        self.finer = None
        self.targets = np.zeros((task.control_steps + 1, error.shape[1]))
        self.cost_weights = np.full(task.control_steps + 1, 1 / max(float(np.square(error).sum()), 1e-12))

    def tracked(self, step: int, state: State, contexts: Contexts) -> np.ndarray:
        return self._task.goal_error(state, contexts)
