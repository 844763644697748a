"""Rewards computed from the state of the simulator."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from stages.environments.protocol import Moment
from stages.environments.simulated import SimulatedMoment
from stages.simulation.contexts import Contexts
from stages.simulation.task import State, Task


class StateReward(ABC):
    """Base class of rewards computed from the state of the simulator, with a single term."""

    frame_period: int | None = None  # There are no frames; the reward observes every state.

    def __init__(self, task: Task):
        self._task = task
        self._returns: list[np.ndarray] = []

    @abstractmethod
    def reward(self, step: int, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        """Rewards (n,) of the actions (n, nu) that led to `state`."""

    def __call__(self, moment: Moment, action: np.ndarray) -> np.ndarray:
        assert isinstance(moment, SimulatedMoment)
        value = self.reward(moment.step, moment.state, action, moment.contexts)
        self._returns.append(value)
        return value

    def terms(self) -> dict[str, float]:
        episodes = max(len(self._returns) // self._task.control_steps, 1)
        total = float(np.mean(np.sum(self._returns, axis=0))) / episodes if self._returns else 0.0
        self._returns.clear()
        return {"return": total}

    def iterate(self) -> None:  # noqa: B027 - the reward never changes
        """No-op."""

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, state: dict[str, Any]) -> None:  # noqa: B027 - there is no state
        """No-op, because there is no state."""

    def close(self) -> None:  # noqa: B027 - optional for subclasses
        """No-op, because there are no resources to free."""


class ExpertReward(StateReward):
    """The hand-written reward of the task, for training experts."""

    def reward(self, step: int, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        return self._task.expert_reward(state, action, contexts)


class OracleReward(StateReward):
    """The paper's oracle: the negative normalized final distance, only at the last step (Sec. VI.B)."""

    def __init__(self, task: Task):
        super().__init__(task)
        self._distances: list[np.ndarray] = []

    def reward(self, step: int, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        distance = self._task.distance(state, contexts)
        if step == 1:
            # The initial state is not available here, so the distance after one control step replaces it.
            self._distances = [distance]
        self._distances.append(distance)
        if step < self._task.control_steps:
            return np.zeros(len(state.qpos))
        initial, final = self._task.outcome(np.stack(self._distances, axis=1))
        return -final / initial


class GoalReward(OracleReward):
    """The oracle for learners with quadratic costs; it also provides the task's error as a vector with target zero.

    At every control step, the cost is half the squared error divided by the squared error in the context's initial
    state. With a quadratic cost only at the last step, just the action penalty would determine the motion before it.
    """

    def __init__(self, task: Task, contexts: Contexts):
        """Scale the cost by the error in the initial state of `contexts` (leading axis 1).

        Raises:
            UsageError: The task does not define `goal_error`.
        """
        from stages.simulation.batch import BatchSimulation

        super().__init__(task)
        start = BatchSimulation(task, 1, 1).reset(*task.context_state(contexts))
        error = task.goal_error(start, contexts)
        self.finer = None
        self.targets = np.zeros((task.control_steps + 1, error.shape[1]))
        self.cost_weights = np.full(task.control_steps + 1, 1 / max(float(np.square(error).sum()), 1e-12))

    def tracked(self, moment: Moment) -> np.ndarray:
        assert isinstance(moment, SimulatedMoment)
        return self._task.goal_error(moment.state, moment.contexts)
