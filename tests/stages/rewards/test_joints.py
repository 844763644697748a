"""Joint-angle tracking pays for the demonstration's own angles and nothing else."""

import numpy as np

from stages.environments.simulated import SimulatedMoment
from stages.rewards.joints import JointsReward
from stages.simulation.task import State
from stages.simulation.tasks.push import Push


def returns(reward, task, qpos):
    """Return of one episode along joint positions (T, nq), given to two equal simulations."""
    total = np.zeros(2)
    for step in range(1, task.control_steps + 1):
        at = np.tile(qpos[min(step // task.frame_every, task.frames - 1)], (2, 1))
        zeros = np.zeros_like(at)
        state = State(at, zeros, np.zeros((2, 1, 3)), np.zeros(2), zeros)
        total += reward(SimulatedMoment(step, state, {}, np.zeros((2, 1))), zeros)
    assert total[0] == total[1]
    return total[0]


def test_following_returns_nothing_and_standing_still_minus_one():
    task = Push()
    path = np.linspace(0, 1, task.frames)[:, None] * np.array([1.0, -0.5, 0.5, 9.0, 9.0])
    reward = JointsReward(task, path)
    assert returns(reward, task, path) == 0.0
    np.testing.assert_allclose(returns(reward, task, np.zeros_like(path)), -1.0)
    object_elsewhere = path.copy()
    object_elsewhere[:, 3:] = -1.0
    assert returns(reward, task, object_elsewhere) == 0.0


def test_the_cost_that_is_tracked_is_the_reward():
    task = Push()
    rng = np.random.default_rng(0)
    path = np.cumsum(0.1 * rng.standard_normal((task.frames, 5)), axis=0)
    moved = path + 0.1 * rng.standard_normal(path.shape)
    reward = JointsReward(task, path, ramp="quadratic")
    apart = np.square(moved[:, :3] - reward.targets[: task.control_steps : task.frame_every]).sum(axis=1)
    cost = 0.5 * (reward.cost_weights[: task.control_steps : task.frame_every] * apart).sum()
    np.testing.assert_allclose(returns(reward, task, moved), -cost)
