"""Many simulations at once step as one alone would."""

from __future__ import annotations

import numpy as np
import pytest

from stages.simulation.batch import BatchSimulation, rollout


def actions(task, n: int) -> np.ndarray:
    """Random actions (control steps, n, nu); half of the simulations push steadily, into their joints' limits."""
    drawn = np.random.default_rng(5).uniform(-1.0, 1.0, (task.control_steps, n, task.action_size))
    drawn[:, ::2] = np.sign(drawn[:1, ::2])
    return drawn


def trajectory(task, contexts, drawn, nthread=0):
    """Joint positions (n, steps + 1, nq)."""
    given = iter(drawn)
    states = task.draw_states(np.random.default_rng(1), contexts)
    return rollout(task, contexts, *states, lambda state, where: next(given), nthread).qpos


def test_states_do_not_depend_on_threads(task, draw):
    contexts, drawn = draw("paper", 9), actions(task, 9)
    one = trajectory(task, contexts, drawn, nthread=1)
    for nthread in (2, 3):
        assert np.array_equal(trajectory(task, contexts, drawn, nthread), one)


def test_states_do_not_depend_on_the_neighbours(task, draw):
    drawn = actions(task, 6)
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
    signs = np.resize([1.0, -1.0], task.action_size)
    state = simulation.step(np.stack([signs, signs * np.resize([7.0, 9.0, 3.0, 2.0], task.action_size)]))
    assert np.array_equal(state.qpos[0], state.qpos[1])
    assert np.array_equal(state.ctrl, [signs, signs])


def test_a_reset_leaves_nothing_behind(task, draw):
    contexts, drawn = draw("paper", 3), actions(task, 3)
    start = task.context_state(contexts)
    simulation = BatchSimulation(task, 3)

    def run():
        return [simulation.reset(*start), *(simulation.step(action) for action in drawn)]

    first, second = run(), run()
    for one, other in zip(first, second, strict=True):
        for name, values in vars(one).items():
            assert np.array_equal(values, getattr(other, name))
    np.testing.assert_allclose(first[-1].time, task.horizon)


def test_states_are_copies(task, draw):
    simulation = BatchSimulation(task, 2)
    before = simulation.reset(*task.context_state(draw("fixed", 2)))
    kept = [np.array(values) for values in vars(before).values()]
    simulation.step(np.ones((2, task.action_size)))
    for values, expected in zip(vars(before).values(), kept, strict=True):
        assert np.array_equal(values, expected)


def test_joints_stay_within_their_limits(task, draw):
    """Steady torque against a stop bends it by some hundredths of a radian, never more."""
    model = task.model
    qpos = trajectory(task, draw("paper", 40), actions(task, 40))
    limited = np.flatnonzero(model.jnt_limited)
    assert len(limited) >= 2
    for joint in limited:
        low, high = model.jnt_range[joint]
        angles = qpos[..., model.jnt_qposadr[joint]]
        assert angles.min() > low - 0.05
        assert angles.max() < high + 0.05


def test_the_learner_cannot_see_the_context(task, draw):
    """Its observation is the same in two contexts that differ in all but where everything stands."""
    qpos, qvel = task.context_state(draw("fixed", 2))
    state = BatchSimulation(task, 2).reset(qpos, qvel)
    contexts = draw("paper", 2)
    seen, told = task.observe(state), task.observe_expert(state, contexts)
    assert np.array_equal(seen[0], seen[1])
    assert np.array_equal(told[0], told[1]) == ("goal" not in contexts)
    assert seen.dtype == told.dtype == np.float32


def test_a_rollout_shows_a_frame_every_second_step(task, draw):
    contexts = draw("paper", 2)
    action = np.ones((2, task.action_size))
    start = task.context_state(contexts)
    result = rollout(task, contexts, *start, lambda state, where: action)
    assert result.qpos.shape == (2, task.control_steps + 1, task.model.nq)
    shown = result.frame_qpos(task)
    assert shown.shape == (2, task.frames, task.model.nq)
    assert np.array_equal(shown, result.qpos[:, [2 * j for j in range(task.frames)]])


def test_a_rollout_is_judged_by_its_first_and_last_state(task, draw):
    contexts = draw("paper", 8)
    drawn = actions(task, 8)
    start = task.context_state(contexts)
    given = iter(drawn)
    result = rollout(task, contexts, *start, lambda state, where: next(given))
    simulation = BatchSimulation(task, 8)
    first = last = simulation.reset(*start)
    for action in drawn:
        last = simulation.step(action)
    assert np.array_equal(result.initial_distance, task.distance(first, contexts))
    assert np.array_equal(result.final_distance, task.distance(last, contexts))
    assert result.normalised_distance == pytest.approx(result.final_distance / result.initial_distance)
    assert result.initial_distance.min() > 0.1
