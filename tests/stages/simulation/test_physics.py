"""Whatever the arm does, nothing leaves the table, nothing blows up, and the same seed gives the same states."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from stages.config.stages import TASKS
from stages.simulation.batch import BatchSimulation
from stages.simulation.registry import distribution, make_task
from stages.simulation.tasks import push, reach, strike, sweep

EPISODES = 1000
SOFT = 0.02  # metres that a soft contact gives way
MODULES = {"reach": reach, "push": push, "sweep": sweep, "strike": strike}
ARMS = {"reach": reach.ARM, "push": push.PUSHER, "sweep": sweep.SWEEPER, "strike": strike.STRIKER}


def number(task):
    """How many episodes; an arm of seven joints takes longer."""
    return EPISODES if task.name in TASKS else EPISODES // 10


def wild_actions(rng, task):
    """Actions (control steps, episodes, nu): half steady at full torque, a quarter held for a while, a quarter not."""
    actions = rng.uniform(-1.0, 1.0, (task.control_steps, number(task), task.action_size))
    actions[:, ::2] = np.sign(actions[:1, ::2])
    actions[:, 1::4] = np.sign(np.repeat(actions[::5, 1::4], 5, axis=0))
    return actions


def episodes(task, seed, nthread):
    """Joint positions and velocities (control steps + 1, episodes, nq) under wild actions."""
    rng = np.random.default_rng(seed)
    contexts = task.draw_contexts(rng, number(task), distribution("paper"))
    simulation = BatchSimulation(task, number(task), nthread)
    states = [simulation.reset(*task.draw_states(rng, contexts))]
    states += [simulation.step(action) for action in wild_actions(rng, task)]
    return np.stack([state.qpos for state in states]), np.stack([state.qvel for state in states])


@pytest.fixture(scope="module")
def wild(task):
    return episodes(task, seed=0, nthread=2)


def test_the_same_seed_gives_the_same_states_on_any_number_of_threads(task, wild):
    for one, other in zip(wild, episodes(task, seed=0, nthread=1), strict=True):
        assert np.array_equal(one, other)


def test_states_stay_finite_and_slow(wild):
    """No contact throws anything about: nothing moves much faster than an arm can swing."""
    qpos, qvel = wild
    assert np.isfinite(qpos).all()
    assert np.abs(qvel).max() < 15  # rad/s and m/s; at full torque an arm comes to some 5 rad/s


@pytest.mark.parametrize("task", ["push", "sweep", "strike"], indirect=True)
def test_no_object_leaves_the_table(task, wild):
    objects = wild[0][:, :, task.action_size :]
    assert np.abs(objects).max() <= MODULES[task.name].TABLE_HALF_SIZE + SOFT
    assert (np.abs(objects[-1] - objects[0]).max(axis=1) > 0.05).mean() > 0.1  # Objects do get pushed about.


@pytest.mark.parametrize("task", ["sweep", "strike"], indirect=True)
def test_no_object_sinks_into_a_wall(task, wild):
    module = MODULES[task.name]
    balls = wild[0][:, :, task.action_size :].reshape(*wild[0].shape[:2], -1, 2)
    names = [task.model.geom(k).name for k in range(task.model.ngeom)]
    walls = [name for name in names if name.endswith("_collider") and name.startswith(("rim", "pan"))]
    assert len(walls) == (7 if task.name == "sweep" else 4)
    for name in walls:
        wall = task.model.geom(name)
        beyond = np.abs(balls - wall.pos[:2]) - wall.size[:2]
        apart = np.linalg.norm(np.maximum(beyond, 0), axis=-1)
        assert apart.min() >= module.BALL_RADIUS - SOFT


@pytest.mark.parametrize("task", ["push", "sweep", "strike"], indirect=True)
@pytest.mark.parametrize("name", ["paper", "fixed"])
def test_the_arm_touches_nothing_at_the_start(task, draw, name):
    contexts = draw(name, 500)
    data = mujoco.MjData(task.model)
    arm = np.flatnonzero(task.model.geom_contype == 1)
    touching = 0
    for qpos, _ in (task.context_state(contexts), task.draw_states(np.random.default_rng(0), contexts)):
        for position in qpos:
            data.qpos[:] = position
            mujoco.mj_kinematics(task.model, data)
            mujoco.mj_collision(task.model, data)
            touching += bool(np.isin(data.contact.geom, arm).any())
    assert touching == 0


@pytest.mark.parametrize("name", ARMS)
def test_the_arms_geometry_agrees_with_the_model(name):
    task, arm = make_task(name), ARMS[name]
    model = task.model
    qpos = np.repeat(model.qpos0[None], 20, axis=0)
    qpos[:, task.posture] = np.random.default_rng(0).uniform(-0.3, 2.6, (20, task.action_size))
    state = BatchSimulation(task, 20).reset(qpos, np.zeros((20, model.nv)))
    hand = state.site_xpos[:, model.site("hand").id, :2]
    np.testing.assert_allclose(hand, arm.hand(qpos[:, task.posture]), atol=1e-12)
