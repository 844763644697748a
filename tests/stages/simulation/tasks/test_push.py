"""Push alone: a cylinder that only the arm moves, and a fork that it stays in."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from stages.simulation.batch import BatchSimulation
from stages.simulation.contexts import DISTRACTOR_RADIUS
from stages.simulation.registry import make_task
from stages.simulation.tasks.push import (
    CYLINDER_RADIUS,
    FORK_HALF_WIDTH,
    FORK_LENGTH,
    FORK_RADIUS,
    GOAL_RADIUS,
    LEAST_PUSH,
    PUSHER,
)
from stages.simulation.tasks.scene import Arm

N = 2000


@pytest.fixture(scope="module")
def task():
    return make_task("push")


def states(task, qpos):
    """The state at joint positions (n, 5), at rest."""
    return BatchSimulation(task, len(qpos)).reset(qpos, np.zeros_like(qpos))


def gap(qpos: np.ndarray) -> np.ndarray:
    """Room (n,) between the cylinder and the nearest part of the arm, at least, at joint positions (n, 5), metres."""
    joints = [np.zeros((len(qpos), 2)), *(Arm(PUSHER.lengths[:k]).hand(qpos[:, :k]) for k in (1, 2, 3))]
    shares = np.linspace(0, 1, 9)[:, None, None]
    links = np.concatenate([one + shares * (other - one) for one, other in itertools.pairwise(joints)])
    from_links = np.linalg.norm(links - qpos[:, 3:], axis=2).min(axis=0) - PUSHER.radius
    from_fork = np.linalg.norm(joints[-1] - qpos[:, 3:], axis=1) - np.hypot(FORK_LENGTH, FORK_HALF_WIDTH) - FORK_RADIUS
    return np.minimum(from_links, from_fork) - CYLINDER_RADIUS


def test_cylinder_and_goal_are_apart(draw):
    for name in ("paper", "narrow", "fixed"):
        contexts = draw(name, N)
        apart = np.linalg.norm(contexts["cylinder"] - contexts["goal"], axis=1)
        assert apart.min() > LEAST_PUSH
        assert apart.min() > CYLINDER_RADIUS + GOAL_RADIUS  # The cylinder covers none of the goal.


def test_cylinders_and_goals_lie_all_over_the_workspace(draw):
    contexts = draw("paper", N)
    for name, least in (("cylinder", 0.15), ("goal", 0.25)):
        assert (contexts[name].std(axis=0) > least).all()
        assert np.linalg.norm(contexts[name], axis=1).max() < sum(PUSHER.lengths)


def test_distractors_are_clear_of_cylinder_and_goal(draw):
    contexts = draw("paper", N)
    for name in ("cylinder", "goal"):
        apart = np.linalg.norm(contexts["distractor_position"] - contexts[name][:, None], axis=2)
        assert apart.min() >= DISTRACTOR_RADIUS + GOAL_RADIUS


def test_the_cylinder_moves_only_where_the_arm_touches_it(task, draw):
    contexts = draw("paper", 400)
    action = 0.3 * np.sign(np.random.default_rng(1).uniform(-1, 1, (400, 3)))
    simulation = BatchSimulation(task, 400)
    qpos = [simulation.reset(*task.context_state(contexts)).qpos]
    qpos += [simulation.step(action).qpos for _ in range(task.control_steps)]
    moved = np.max([np.abs(one[:, 3:] - qpos[0][:, 3:]).max(axis=1) for one in qpos], axis=0)
    far = np.min([gap(one) for one in qpos], axis=0) > 0.15  # more than the arm covers between two control steps
    assert far.sum() > 20
    assert (moved[far] == 0).all()
    assert (moved > 0.05).sum() > 20


def test_the_fork_pushes_the_cylinder_ahead_of_it(task):
    def folded(angle):
        """Postures whose fork points along x, the hand on the x axis."""
        return np.array([-angle, 2 * angle, -angle])

    hand = PUSHER.hand(folded(1.0)[None])[0]
    qpos = np.array([[*folded(1.0), hand[0] + 0.25, hand[1]]])
    simulation = BatchSimulation(task, 1)
    state = simulation.reset(qpos, np.zeros_like(qpos))
    for _ in range(task.control_steps):
        state = simulation.step(3 * (folded(0.8) - state.qpos[:, :3]) - 0.3 * state.qvel[:, :3])
    ahead = state.qpos[0, 3:] - state.site_xpos[0, 0, :2]
    way = state.qpos[0, 3:] - qpos[0, 3:]
    assert way[0] > 0.08
    assert abs(way[1]) < 0.02
    assert 0.2 < ahead[0] < 0.25  # It lies in the fork: not inside the hand, not off on its own.
    assert np.abs(state.qvel[0, 3:]).max() < 0.02


def test_the_learner_cannot_see_the_cylinder_and_the_expert_can(task, draw):
    contexts = draw("fixed", 2)
    qpos, _ = task.context_state(contexts)
    qpos[1, 3:] += 0.1
    state = states(task, qpos)
    seen, told = task.observe(state), task.observe_expert(state, contexts)
    assert np.array_equal(seen[0], seen[1])
    assert not np.array_equal(told[0], told[1])


def test_the_reward_grows_as_the_cylinder_nears_the_goal(task, draw):
    contexts = draw("paper", 50)
    qpos, _ = task.context_state(contexts)
    rewards = []
    for share in np.linspace(0, 1, 5):
        at = np.array(qpos)
        at[:, 3:] += share * (contexts["goal"] - contexts["cylinder"])
        rewards.append(task.expert_reward(states(task, at), np.zeros((50, 3)), contexts))
    assert (np.diff(rewards, axis=0) > 0).all()


def test_the_distance_is_the_cylinders_to_the_goal(task, draw):
    contexts = draw("paper", 3)
    qpos, _ = task.context_state(contexts)
    qpos[:, 3:] = contexts["goal"] + np.array([[0.0, 0.0], [0.3, 0.0], [0.3, -0.4]])
    np.testing.assert_allclose(task.distance(states(task, qpos), contexts), [0.0, 0.3, 0.5], atol=1e-12)
