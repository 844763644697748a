"""Many simulations at once step as one alone would."""

from __future__ import annotations

import numpy as np
import pytest

from stages.simulation.batch import BatchSimulation, rollout


def actions(n: int, steps: int = 50) -> np.ndarray:
    """Random actions (steps, n, 3); half of the simulations push steadily, into their joints' limits."""
    drawn = np.random.default_rng(5).uniform(-1.0, 1.0, (steps, n, 3))
    drawn[:, ::2] = np.sign(drawn[:1, ::2])
    return drawn


def trajectory(task, contexts, drawn, nthread=0):
    """Joint positions (n, steps + 1, nq)."""
    given = iter(drawn)
    states = task.draw_states(np.random.default_rng(1), contexts)
    return rollout(task, contexts, *states, lambda state, where: next(given), nthread).qpos


def test_states_do_not_depend_on_threads(task, draw):
    contexts, drawn = draw("paper", 9), actions(9)
    one = trajectory(task, contexts, drawn, nthread=1)
    for nthread in (2, 3):
        assert np.array_equal(trajectory(task, contexts, drawn, nthread), one)


def test_states_do_not_depend_on_the_neighbours(task, draw):
    drawn = actions(6)
    states = np.array(task.draw_states(np.random.default_rng(1), draw("paper", 6)))
    together, alone = BatchSimulation(task, 6), BatchSimulation(task, 1)
    state = together.reset(*states)
    single = alone.reset(*states[:, 4:5])
    for action in drawn:
        state, single = together.step(action), alone.step(action[4:5])
        assert np.array_equal(state.qpos[4], single.qpos[0])


def test_actions_are_clipped(task, draw):
    qpos, qvel = task.context_state(draw("fixed", 2))
    simulation = BatchSimulation(task, 2)
    simulation.reset(qpos, qvel)
    state = simulation.step(np.array([[1.0, -1.0, 1.0], [7.0, -9.0, 3.0]]))
    assert np.array_equal(state.qpos[0], state.qpos[1])


def test_a_reset_leaves_nothing_behind(task, draw):
    contexts, drawn = draw("paper", 3), actions(3)
    start = task.context_state(contexts)
    simulation = BatchSimulation(task, 3)

    def run():
        simulation.reset(*start)
        return [simulation.step(action) for action in drawn]

    first, second = run(), run()
    for one, other in zip(first, second, strict=True):
        assert np.array_equal(one.qpos, other.qpos)
        assert np.array_equal(one.time, other.time)
    np.testing.assert_allclose(first[-1].time, task.horizon)


def test_states_are_copies(task, draw):
    simulation = BatchSimulation(task, 2)
    before = simulation.reset(*task.context_state(draw("fixed", 2)))
    kept = [np.array(values) for values in vars(before).values()]
    simulation.step(np.ones((2, 3)))
    for values, expected in zip(vars(before).values(), kept, strict=True):
        assert np.array_equal(values, expected)


def test_elbows_stay_within_their_limits(task, draw):
    from stages.simulation.reach import ELBOW_RANGE

    qpos = trajectory(task, draw("paper", 40), actions(40))[..., 1:]
    assert qpos.min() > ELBOW_RANGE[0] - 0.05
    assert qpos.max() < ELBOW_RANGE[1] + 0.05


def test_the_learner_cannot_see_the_context(task, draw):
    """Its observation is the same in two contexts that differ in all but the arm's posture."""
    qpos, qvel = task.context_state(draw("fixed", 2))
    state = BatchSimulation(task, 2).reset(qpos, qvel)
    seen, told = task.observe(state), task.observe_expert(state, draw("paper", 2))
    assert np.array_equal(seen[0], seen[1])
    assert not np.array_equal(told[0], told[1])
    assert seen.dtype == told.dtype == np.float32


def test_a_rollout_shows_a_frame_every_second_step(task, draw):
    contexts = draw("paper", 2)
    result = rollout(task, contexts, *task.context_state(contexts), lambda state, where: np.ones((2, 3)))
    assert result.qpos.shape == (2, task.control_steps + 1, 3)
    assert result.distance.shape == (2, task.control_steps + 1)
    shown = result.frame_qpos(task)
    assert shown.shape == (2, task.frames, 3)
    assert np.array_equal(shown, result.qpos[:, [2 * j for j in range(task.frames)]])
    assert result.normalised_distance == pytest.approx(result.distance[:, -1] / result.distance[:, 0])
