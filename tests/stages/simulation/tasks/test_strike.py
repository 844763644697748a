"""Strike alone: targets beyond the arm's reach, and a ball that slides to them."""

from __future__ import annotations

import numpy as np
import pytest

from stages.config.stages import TASKS
from stages.simulation.batch import BatchSimulation
from stages.simulation.registry import distribution, make_task
from stages.simulation.tasks.strike import (
    BALL,
    BALL_RADIUS,
    BALL_RUN,
    GOAL_RADIUS,
    LINK_LENGTH,
    MALLET_HALF_WIDTH,
    MALLET_RADIUS,
    STRIKER,
    TABLE_HALF_SIZE,
)

N = 2000


@pytest.fixture(scope="module")
def task():
    return make_task("strike")


def start(task, n, ball, velocity):
    """A simulation of n arms at their nominal start, and its state; the ball's place and velocity (2,) or (n, 2)."""
    qpos, qvel = task.context_state(task.draw_contexts(np.random.default_rng(0), n, distribution("fixed")))
    qpos[:, 4:], qvel[:, 4:] = ball, velocity
    simulation = BatchSimulation(task, n)
    return simulation, simulation.reset(qpos, qvel)


def test_goals_lie_beyond_the_arms_reach(draw):
    """Held by the outstretched arm's mallet, at its corner, the ball is still short of every goal."""
    stretched = STRIKER.hand(np.zeros((1, 4)))[0]
    assert stretched == pytest.approx(STRIKER.base + np.array([4 * LINK_LENGTH, 0.0]))
    corner = np.hypot(4 * LINK_LENGTH, MALLET_HALF_WIDTH) + MALLET_RADIUS + BALL_RADIUS
    for name in ("paper", "narrow", "fixed"):
        goals = draw(name, N)["goal"]
        assert np.linalg.norm(goals - STRIKER.base, axis=1).min() > corner


def test_goals_are_on_the_table_and_clear_of_the_ball(draw):
    goals = draw("paper", N)["goal"]
    assert np.linalg.norm(goals - BALL, axis=1).min() > GOAL_RADIUS + BALL_RADIUS
    assert np.abs(goals).max() < TABLE_HALF_SIZE - GOAL_RADIUS
    assert (goals.std(axis=0) > 0.05).all()


def test_a_ball_rests_where_its_velocity_says(task):
    rng = np.random.default_rng(0)
    speed, angle = rng.uniform(0.2, 1.8, 50), rng.uniform(-0.25 * np.pi, 0.25 * np.pi, 50)
    velocity = speed[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    simulation, state = start(task, 50, BALL, velocity)
    predicted = BALL + BALL_RUN * velocity
    for _ in range(task.control_steps):
        state = simulation.step(np.zeros((50, 4)))
        np.testing.assert_allclose(state.qpos[:, 4:] + BALL_RUN * state.qvel[:, 4:], predicted, atol=1e-9)
    np.testing.assert_allclose(state.qpos[:, 4:], predicted, atol=0.005)
    assert np.abs(state.qvel[:, 4:]).max() < 0.01


@pytest.mark.parametrize("direction", [(1, 0), (0, 1), (0, -1), (0.7, 0.7)])
def test_the_rim_keeps_the_fastest_ball_on_the_table(task, direction):
    simulation, state = start(task, 1, BALL, 5.0 * np.array(direction))
    furthest = 0.0
    for _ in range(task.control_steps):
        state = simulation.step(np.zeros((1, 4)))
        furthest = max(furthest, float(np.abs(state.qpos[0, 4:]).max()))
    assert TABLE_HALF_SIZE - BALL_RADIUS - 0.05 < furthest <= TABLE_HALF_SIZE


def test_a_swing_sends_the_ball_beyond_the_arms_reach(task):
    simulation, state = start(task, 1, BALL, 0.0)
    for _ in range(task.control_steps):
        state = simulation.step(np.array([[1.0, -1.0, -1.0, 1.0]]))
    ball = state.qpos[0, 4:]
    assert np.linalg.norm(ball - STRIKER.base) > sum(STRIKER.lengths) + MALLET_RADIUS + BALL_RADIUS
    assert np.linalg.norm(state.qvel[0, 4:]) < 0.02


def test_the_ball_stays_put_until_it_is_struck(task):
    simulation, state = start(task, 1, BALL, 0.0)
    for _ in range(task.control_steps):
        state = simulation.step(np.zeros((1, 4)))
    assert np.array_equal(state.qpos[0, 4:], BALL)


def test_the_best_velocity_is_the_one_that_ends_on_the_goal(task, draw):
    contexts = draw("paper", 30)
    shares = np.linspace(0, 2, 9)
    rewards = []
    for share in shares:
        _, state = start(task, 30, BALL, share * (contexts["goal"] - BALL) / BALL_RUN)
        rewards.append(task.expert_reward(state, np.zeros((30, 4)), contexts))
    assert (shares[np.argmax(rewards, axis=0)] == 1.0).all()


def test_the_learner_sees_the_ball_but_not_the_goal(task, draw):
    _, state = start(task, 2, np.array([BALL, BALL + 0.1]), 0.0)
    seen = task.observe(state)
    assert not np.array_equal(seen[0], seen[1])
    _, state = start(task, 2, BALL, 0.0)
    told = task.observe_expert(state, draw("paper", 2))
    assert not np.array_equal(told[0], told[1])


def test_the_reward_is_ramped_in_strike_alone():
    ramps = {name: make_task(name).ramp for name in TASKS}
    assert ramps == {"reach": "none", "push": "none", "sweep": "none", "strike": "quadratic"}
