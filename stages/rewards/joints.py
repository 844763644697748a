"""Joint-angle tracking: learning from one kinesthetic demonstration that was recorded in a different context.

This is the paper's baseline for the real tasks (Sec. VI.D). It fails if the task requires different joint angles in the
learner's context than in the context of the demonstration.
"""

from __future__ import annotations

import numpy as np

from stages.environments.protocol import Moment
from stages.environments.simulated import SimulatedMoment
from stages.environments.timing import Timing
from stages.rewards.frames import time_weights, tracking_cost
from stages.rewards.state import StateReward
from stages.simulation.contexts import Contexts
from stages.simulation.task import State, Task


class JointsReward(StateReward):
    """Negative squared distance of the actuated joints from the demonstration at the same frame.

    The distance is divided by the demonstration's squared motion summed over its frames, so that the return of standing
    still is about -1.
    """

    def __init__(self, task: Task, demonstration: np.ndarray, ramp: str = "none"):
        """Track `demonstration`, joint positions (T, nq) at the frames of a video, in radians."""
        super().__init__(task)
        self._driven = task.posture
        self._target = demonstration[:, self._driven]
        self._scale = max(float(np.square(self._target - self._target[0]).sum()), 1e-6)
        self._timing = Timing.regular(task.control_steps, task.frame_every)
        self._weights = time_weights(ramp, self._timing.frames)
        self.finer = None
        self.targets, self.cost_weights = tracking_cost(self._timing, self._target, self._weights / self._scale)

    def reward(self, step: int, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        frame = self._timing.frame_at(step)
        if frame is None:
            return np.zeros(len(state.qpos))
        error = np.square(state.qpos[:, self._driven] - self._target[frame]).sum(axis=1)
        return -self._weights[frame] * error / self._scale

    def tracked(self, moment: Moment) -> np.ndarray:
        assert isinstance(moment, SimulatedMoment)
        return moment.state.qpos[:, self._driven]
