"""Tasks of dm_control's suite: what it draws, observes and rewards, and contexts on top."""

from __future__ import annotations

import numpy as np
import pytest
from dm_control import suite as dm_suite

from artifacts import UsageError
from stages.simulation import gym_registration, suite
from stages.simulation.batch import BatchSimulation, rollout
from stages.simulation.registry import distribution, make_task
from stages.simulation.render import TileRenderer
from stages.simulation.tasks.dm import JOINT_NOISE
from stages.simulation.tasks.scene import Arm

REACHER, CHEETAH = "dm:reacher-easy", "dm:cheetah-run"  # a camera that stands still, and one that follows
STEPS = 40


@pytest.fixture(scope="module", params=[REACHER])
def task(request):
    made = make_task(request.param)
    made.control_steps = STEPS
    return made


def both(*names):
    """Run a test on these tasks of the suite."""
    return pytest.mark.parametrize("task", names, indirect=True)


@pytest.fixture
def own(task):
    """dm_control's own environment of the task, drawn in the quality of ours."""
    env = dm_suite.load(*task.name.removeprefix("dm:").split("-"), task_kwargs={"random": 0})
    quality, ours = env.physics.model.vis.quality, task.model.vis.quality
    for name in ("offsamples", "shadowsize", "numslices", "numstacks", "numquads"):
        setattr(quality, name, getattr(ours, name))
    yield env
    env.close()


@pytest.fixture
def picture(task):
    """A function (contexts, joint positions (n, nq), by default theirs) -> frames (n, H, W, 3)."""
    renderer = TileRenderer(task.model, *task.frame_size, task.camera)

    def drawn(contexts, qpos=None):
        qpos = task.context_state(contexts)[0] if qpos is None else qpos
        return renderer.render(task.model_fields(contexts), qpos[:, None])[:, 0].astype(int)

    yield drawn
    renderer.close()


def flat(observation):
    return np.concatenate([np.ravel(value) for value in observation.values()])


def differing(one, other):
    """Share of pixels that are not the same."""
    return (np.abs(one.astype(int) - other).max(axis=-1) > 0).mean()


@pytest.mark.gl
@both(REACHER, CHEETAH)
def test_a_fixed_context_looks_as_in_the_suite(task, draw, own, picture):
    own.reset()
    own.physics.data.qpos[0] += 3.0  # The cheetah runs, and its camera with it; the reacher turns.
    own.physics.forward()
    # At this size neither shadows nor what the floor reflects is worth drawing.
    expected = own.physics.render(*task.frame_size, camera_id=0, render_flag_overrides={"reflection": False})
    got = picture(draw("fixed"), np.array(own.physics.data.qpos)[None])[0]
    assert differing(got, expected) <= 0.01
    assert expected.std() > 10


@pytest.mark.gl
@both(REACHER, CHEETAH)
def test_both_faces_draw_the_same_frame(task, picture):
    env = suite.load(task.name, contexts="paper", seed=1)
    env.reset()
    seen = suite.frame(env.physics, task)
    got = picture(env.task.contexts, np.array(env.physics.data.qpos)[None])[0]
    env.close()
    assert differing(got, seen) <= 0.01


@both(REACHER, CHEETAH, "dm:walker-walk", "dm:finger-spin", "dm:hopper-hop")
def test_states_observations_and_rewards_are_the_suites_own(task, draw, own):
    contexts = draw("fixed")
    own.reset()
    qpos, qvel = task.context_state(contexts)
    assert np.array_equal(own.physics.data.qpos, qpos[0])
    qvel += np.random.default_rng(1).normal(size=qvel.shape)  # Everything moves, whether an action drives it or not.
    own.physics.data.qvel[:] = qvel[0]
    own.physics.forward()
    simulation = BatchSimulation(task, 1)
    simulation.reset(qpos, qvel)
    for action in np.random.default_rng(0).uniform(-1, 1, (STEPS, 1, task.action_size)):
        step, state = own.step(action[0]), simulation.step(action)
        np.testing.assert_allclose(state.qpos[0], own.physics.data.qpos, rtol=0, atol=1e-9)
        observation, expected = task.observe_expert(state, contexts)[0], flat(step.observation)
        # Touch speaks of the state itself, where dm_control shows what it was inside the last physics step.
        felt = flat({name: np.full(np.shape(value), name == "touch") for name, value in step.observation.items()})
        compared = ~felt.astype(bool)
        np.testing.assert_allclose(observation[compared], expected[compared], rtol=1e-6, atol=1e-6)
        assert task.expert_reward(state, action, contexts)[0] == pytest.approx(step.reward, abs=1e-9)


@both("dm:walker-walk", CHEETAH)
def test_an_episode_is_judged_by_the_share_of_the_reward_that_it_missed(task, draw, own):
    contexts = draw("fixed")
    actions = np.random.default_rng(1).uniform(-1, 1, (STEPS, 1, task.action_size))
    own.reset()
    rewards = [own.step(action[0]).reward for action in actions]
    given = iter(actions)
    result = rollout(task, contexts, *task.context_state(contexts), lambda state, where: next(given))
    assert result.initial_distance == 1.0
    assert result.final_distance == pytest.approx(1.0 - np.mean(rewards))


def test_an_episode_that_does_everything_right_has_distance_zero(task):
    initial, final = task.outcome(np.stack([np.r_[0.7, np.zeros(STEPS)], np.ones(STEPS + 1)]))
    assert initial.tolist() == [1.0, 1.0]
    assert final.tolist() == [0.0, 1.0]


def test_actions_last_as_long_as_in_the_suite(task, own):
    assert task.control_timestep == pytest.approx(own.control_timestep())
    assert make_task(task.name).control_steps == round(own._step_limit)


@pytest.mark.gl
def test_the_picture_turns_with_the_azimuth(task, draw, picture):
    """The reacher is seen from above: the picture turns as a whole."""
    contexts = draw("fixed", 4)
    frames = picture(contexts | {"azimuth": np.array([0.0, 90.0, 180.0, 270.0])})
    for quarter in range(1, 4):
        assert differing(np.rot90(frames[0], -quarter), frames[quarter]) <= 0.01
        assert differing(frames[0], frames[quarter]) > 0.05


@pytest.mark.gl
@both(CHEETAH)
def test_from_behind_everything_is_the_other_way_round(task, draw, picture):
    contexts = draw("fixed", 2)
    front, back = picture(contexts | {"azimuth": np.array([0.0, 180.0])})
    cheetah = [(frame[..., 0] - frame[..., 2]) > 20 for frame in (front, back)]  # orange, on blue
    assert cheetah[0].sum() > 50
    assert (cheetah[0][:, ::-1] ^ cheetah[1]).sum() < 0.3 * (cheetah[0] ^ cheetah[1]).sum()


@pytest.mark.gl
def test_everything_but_the_target_changes_its_colour(task, draw, picture):
    contexts = draw("paper", 30, vary="colour")
    frames = picture(contexts)
    same = np.ptp(frames, axis=0).max(axis=-1) <= 3
    red = frames[0, ..., 0] - frames[0, ..., 1:].max(axis=-1) > 60
    assert (same & red).sum() >= 20
    assert (frames.std(axis=0).max(axis=-1) > 20).mean() > 0.5
    materials = task.model_fields(contexts)["mat_rgba"]
    for k in range(task.model.nmat):
        varies = bool(np.ptp(materials[:, k], axis=0).any())
        assert varies == ("target" not in task.model.mat(k).name)


def test_where_the_suite_puts_the_target_is_part_of_the_context(task, draw):
    contexts = draw("paper", 8)
    target = task.model.geom("target").id
    places = task.model_fields(contexts)["geom_pos"][:, target, :2]
    assert (places.std(axis=0) > 0.02).all()
    state = BatchSimulation(task, 8).reset(*task.context_state(contexts))
    seen = task.observe_expert(state, contexts)  # positions, the way from finger to target, velocities
    finger = Arm((0.12, 0.12)).hand(state.qpos)
    np.testing.assert_allclose(seen[:, :4], np.concatenate([state.qpos, places - finger], axis=1), atol=1e-6)


def test_fixed_contexts_are_all_the_same(task, draw):
    for values in draw("fixed", 3, seed=5).values():
        assert (values == values[0]).all()


def test_contexts_follow_from_the_seed(task, draw):
    one, same, other = draw("paper", 3, 3), draw("paper", 3, 3), draw("paper", 3, 4)
    assert all(np.array_equal(one[name], same[name]) for name in one)
    for name in ("azimuth", "material_rgb", "initial_qpos", "geom_pos"):
        assert not np.array_equal(one[name], other[name])


@both(CHEETAH)
def test_an_episode_starts_near_its_contexts_state(task, draw):
    contexts = draw("fixed", 200)
    (given, _), (qpos, qvel) = task.context_state(contexts), task.draw_states(np.random.default_rng(0), contexts)
    assert 0 < np.abs(qpos - given).max() <= JOINT_NOISE
    assert (qpos.std(axis=0) > 0.2 * JOINT_NOISE).any()
    for joint in np.flatnonzero(task.model.jnt_limited):
        low, high = task.model.jnt_range[joint]
        angles = qpos[:, task.model.jnt_qposadr[joint]]
        assert low <= angles.min()
        assert angles.max() <= high
    assert np.array_equal(qvel, contexts["initial_qvel"])


@pytest.mark.parametrize("name", ["dm:reacher", "dm:nowhere-easy", "dm:reacher-impossible", "dm:"])
def test_unknown_names_are_usage_errors(name):
    with pytest.raises(UsageError, match=r"expected dm:DOMAIN-TASK, for example .*dm:reacher-easy"):
        make_task(name)


def test_the_gymnasium_face_makes_any_task_of_the_suite():
    env = gym_registration.make(REACHER, observe="expert")
    observation, info = env.reset(seed=0)
    assert info["normalised_distance"] == 1.0
    own = make_task(REACHER)
    rewards = []
    for _ in range(5):
        assert observation in env.observation_space
        assert observation["expert"].shape == (6,)
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        rewards.append(reward)
        assert not (terminated or truncated)
    assert info["normalised_distance"] == pytest.approx(1.0 - np.mean(rewards))
    assert env.observation_space["position"].shape == (own.model.nq,)
    env.close()


def test_a_factor_that_the_suite_lacks_is_a_usage_error(task):
    with pytest.raises(UsageError, match="--vary distractors"):
        task.draw_contexts(np.random.default_rng(0), 1, distribution("paper", "azimuth,distractors"))
