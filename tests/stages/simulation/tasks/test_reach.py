"""Reach alone: every goal can be reached, and starts away from the hand."""

from __future__ import annotations

import numpy as np
import pytest

from stages.simulation import suite
from stages.simulation.contexts import N_DISTRACTORS
from stages.simulation.registry import make_task
from stages.simulation.tasks import reach

N = 2000


@pytest.fixture(scope="module")
def task():
    return make_task("reach")


def test_goals_are_reachable(draw):
    goals = np.linalg.norm(draw("paper", N)["goal"], axis=1)
    elbows = np.stack(np.meshgrid(*[np.linspace(*reach.ELBOW_RANGE, 60)] * 2), axis=-1).reshape(-1, 2)
    qpos = np.concatenate([np.zeros((len(elbows), 1)), elbows], axis=1)
    radii = np.sort(np.linalg.norm(reach.ARM.hand(qpos), axis=1))
    within = radii[(radii > goals.min() - 0.05) & (radii < goals.max() + 0.05)]
    assert within[0] < goals.min()
    assert within[-1] > goals.max()
    assert np.diff(within).max() < 0.01  # The first joint turns freely: every radius means every direction.


def test_goals_are_away_from_where_the_hand_starts(task, draw):
    contexts = draw("paper", N)
    for qpos, _ in (task.context_state(contexts), task.draw_states(np.random.default_rng(0), contexts)):
        assert np.linalg.norm(reach.ARM.hand(qpos) - contexts["goal"], axis=1).min() > 0.3


def test_table_arm_and_goal_differ_clearly_in_colour(draw):
    contexts = draw("paper", N)
    table, arm = contexts["table_rgb"], contexts["arm_rgb"]
    for one, other in [(table, reach.RED), (arm, reach.RED), (table, arm)]:
        assert np.linalg.norm(one - other, axis=1).min() >= 0.5


def test_distractors_reach_into_the_workspace_but_not_over_the_goal(draw):
    contexts = draw("paper", N)
    positions, goals = contexts["distractor_position"], contexts["goal"]
    assert positions.shape == (N, N_DISTRACTORS, 2)
    assert np.linalg.norm(positions, axis=2).max() < 3 * reach.LINK_LENGTH
    assert (np.linalg.norm(positions, axis=2) < 0.8).mean() > 0.3
    apart = np.linalg.norm(positions - goals[:, None], axis=2)
    assert apart.min() >= reach.GOAL_RADIUS + reach.DISTRACTOR_RADIUS


def test_the_reward_grows_towards_the_goal():
    env = suite.load("reach", seed=0)
    rng = np.random.default_rng(0)
    rewards, distances = [], []
    for _ in range(30):
        step = env.reset()
        while not step.last():
            step = env.step(rng.uniform(-1.5, 1.5, 3))
        rewards.append(step.reward)
        distances.append(env.task.distance(env.physics))
    env.close()
    assert np.corrcoef(rewards, distances)[0, 1] < -0.9
