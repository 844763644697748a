"""Sweep alone: five balls, and a pan that they enter by its open side only."""

from __future__ import annotations

import numpy as np
import pytest

from stages.simulation.batch import BatchSimulation
from stages.simulation.registry import make_task
from stages.simulation.tasks.sweep import BALL_RADIUS, N_BALLS, NOMINAL_QPOS, PAN_HIGH, PAN_LOW, PAN_WALL

MIDDLE = (PAN_LOW + PAN_HIGH) / 2
INSIDE_HIGH = PAN_HIGH - np.array([0.0, BALL_RADIUS])  # A ball is inside once it has passed the open side whole.
CORNER = np.array([[-1.25, -1.25], [-1.25, -1.0], [-1.25, -0.75], [-1.25, -0.5]])  # out of everything's way


@pytest.fixture(scope="module")
def task():
    return make_task("sweep")


def place(task, balls, velocities=None):
    """A simulation of n arms at their nominal posture, and its state; balls (n, 5, 2), velocities alike."""
    n = len(balls)
    qpos = np.concatenate([np.tile(NOMINAL_QPOS, (n, 1)), np.reshape(balls, (n, -1))], axis=1)
    qvel = np.zeros_like(qpos)
    if velocities is not None:
        qvel[:, 3:] = np.reshape(velocities, (n, -1))
    simulation = BatchSimulation(task, n)
    return simulation, simulation.reset(qpos, qvel)


def balls_of(state):
    return state.qpos[:, 3:].reshape(-1, N_BALLS, 2)


def test_balls_do_not_overlap_at_the_start(draw):
    for name in ("paper", "narrow", "fixed"):
        balls = draw(name, 2000)["balls"]
        apart = np.linalg.norm(balls[:, :, None] - balls[:, None], axis=3) + 9 * np.eye(N_BALLS)
        assert apart.min() >= 2 * BALL_RADIUS


def test_balls_start_outside_the_pan(task, draw):
    contexts = draw("paper", 500)
    balls = contexts["balls"]
    assert (balls[..., 1] > PAN_HIGH[1] + BALL_RADIUS).all()
    _, state = place(task, balls)
    assert task.distance(state, contexts).min() > 0.4


def test_the_distance_is_zero_exactly_when_all_balls_are_inside(task):
    rng = np.random.default_rng(0)
    inside = rng.uniform(PAN_LOW, INSIDE_HIGH, (200, N_BALLS, 2))
    assert (task.distance(place(task, inside)[1], {}) == 0).all()
    which = rng.integers(N_BALLS, size=200)
    for axis, limit, sign in ((0, PAN_LOW, -1), (0, PAN_HIGH, 1), (1, PAN_LOW, -1), (1, INSIDE_HIGH, 1)):
        out = np.array(inside)
        out[np.arange(200), which, axis] = limit[axis] + sign * 0.05
        np.testing.assert_allclose(task.distance(place(task, out)[1], {}), 0.05 / N_BALLS)


def test_a_ball_half_way_through_the_open_side_is_not_inside(task):
    balls = np.tile(MIDDLE, (1, N_BALLS, 1))
    balls[0, 2] = MIDDLE[0], PAN_HIGH[1]
    assert task.distance(place(task, balls)[1], {}) == pytest.approx(BALL_RADIUS / N_BALLS)


@pytest.mark.parametrize("speed", [3.0, 5.0, 8.0])
def test_a_ball_enters_the_pan_by_its_open_side_alone(task, speed):
    gap = 2 * PAN_WALL + BALL_RADIUS + 0.1  # from a wall's inner side to where the ball is thrown from
    throws = [
        ((PAN_LOW[0] - gap, MIDDLE[1]), (1, 0)),
        ((PAN_HIGH[0] + gap, MIDDLE[1]), (-1, 0)),
        ((MIDDLE[0], PAN_LOW[1] - gap), (0, 1)),
        ((MIDDLE[0], PAN_HIGH[1] + BALL_RADIUS), (0, -1)),
    ]
    balls = np.stack([np.concatenate([[start], CORNER]) for start, _ in throws])
    velocities = np.zeros_like(balls)
    velocities[:, 0] = speed * np.array([direction for _, direction in throws])
    simulation, state = place(task, balls, velocities)
    entered = np.zeros(len(throws), bool)
    for _ in range(20):
        state = simulation.step(np.zeros((len(throws), 3)))
        thrown = balls_of(state)[:, 0]
        entered |= ((thrown > PAN_LOW) & (thrown < INSIDE_HIGH)).all(axis=1)
    assert entered.tolist() == [False, False, False, True]
    assert np.array_equal(balls_of(state)[:, 1:], balls[:, 1:])


def test_a_ball_that_is_left_alone_stops_soon(task):
    balls = np.concatenate([[[0.0, 0.2]], CORNER])[None]
    velocities = np.zeros_like(balls)
    velocities[0, 0] = 1.0, 0.0
    simulation, state = place(task, balls, velocities)
    for _ in range(12):
        state = simulation.step(np.zeros((1, 3)))
    assert np.linalg.norm(state.qvel[0, 3:5]) < 0.01
    assert balls_of(state)[0, 0] == pytest.approx([0.1, 0.2], abs=0.005)


def test_the_broom_sweeps_balls_into_the_pan(task, draw):
    contexts = draw("fixed")
    simulation = BatchSimulation(task, 1)
    state = simulation.reset(*task.context_state(contexts))
    before = task.distance(state, contexts)
    for _ in range(task.control_steps):
        state = simulation.step(np.array([[-1.0, 1.0, 0.0]]))
    assert task.distance(state, contexts) < 0.4 * before


def test_the_reward_grows_with_every_ball_in_the_pan(task, draw):
    outside = draw("fixed")["balls"][0]
    inside = MIDDLE + np.array([[-0.3, 0.0], [-0.1, 0.0], [0.1, 0.0], [0.3, 0.0], [0.0, -0.18]])
    balls = np.stack([np.concatenate([inside[:k], outside[k:]]) for k in range(N_BALLS + 1)])
    _, state = place(task, balls)
    assert (np.diff(task.expert_reward(state, np.zeros((N_BALLS + 1, 3)), {})) > 0).all()


def test_the_learner_sees_the_balls(task, draw):
    balls = np.repeat(draw("fixed")["balls"], 2, axis=0)
    balls[1, 3] += 0.1
    _, state = place(task, balls)
    seen = task.observe(state)
    assert not np.array_equal(seen[0], seen[1])
