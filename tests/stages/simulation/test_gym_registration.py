"""The Gymnasium face."""

from __future__ import annotations

import os
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_for_stable_baselines3

import stages.simulation.gym_registration as face
from artifacts import PlatformError
from stages.runtime.seeding import generator
from stages.simulation import gl
from stages.simulation.registry import distribution
from stages.simulation.render import RenderPool

OPTIONS = [
    pytest.param({}, id="states"),
    pytest.param({"observe": "expert", "contexts": "narrow"}, id="expert"),
    pytest.param({"pixels": True, "render_mode": "rgb_array"}, id="pixels", marks=pytest.mark.gl),
]


def gym_id(task):
    """The task's Gymnasium id: `ifo/PushReal-v0` of push-real."""
    return f"ifo/{task.name.title().replace('-', '')}-v0"


@pytest.fixture
def make(task):
    """`gymnasium.make` of the task; what it made is closed at the end."""
    made = []

    def maker(**options):
        made.append(gymnasium.make(gym_id(task), **options))
        return made[-1]

    yield maker
    for env in made:
        env.close()


@pytest.mark.gl
@pytest.mark.parametrize("options", OPTIONS)
def test_gymnasiums_own_checks_pass(make, options):
    env = make(**options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*Box observation space m..imum value is -?infinity.*")
        check_env(env.unwrapped)


@pytest.mark.parametrize("options", OPTIONS)
def test_observations_lie_in_their_space(make, options):
    env = make(**options)
    observation, _ = env.reset(seed=0)
    for _ in range(3):
        assert list(observation) == list(env.observation_space)
        assert observation in env.observation_space
        observation = env.step(env.action_space.sample())[0]


def test_episodes_are_truncated_after_50_steps(make):
    env = make()
    for seed in (0, None):
        env.reset(seed=seed)
        ends = [env.step(env.action_space.sample())[2:4] for _ in range(50)]
        assert ends == 49 * [(False, False)] + [(False, True)]


def test_a_seed_gives_the_episodes_of_the_batch(make):
    env = make(contexts="narrow")
    for _ in range(2):
        for k in range(3):
            observation, info = env.reset(seed=5 if k == 0 else None)
            task = env.unwrapped.task.task
            rng = generator(5, "episode", k)
            contexts = task.draw_contexts(rng, 1, distribution("narrow"))
            qpos, _ = task.draw_states(rng, contexts)
            assert np.array_equal(observation["position"], qpos[0])
            assert all(np.array_equal(env.unwrapped.task.contexts[name], contexts[name]) for name in contexts)
            assert info["normalised_distance"] == 1.0


def test_unseeded_environments_differ(make):
    one, other = make().reset()[0], make().reset()[0]
    assert not np.array_equal(one["position"], other["position"])


def test_the_generator_is_gymnasiums(make):
    env = make()
    env.reset(seed=1)
    assert isinstance(env.unwrapped.np_random, np.random.Generator)
    assert env.unwrapped.np_random_seed == 1


def test_info_tells_how_far_the_goal_is(make):
    env = make(contexts="narrow")
    env.reset(seed=2)
    first = env.unwrapped.task.distance(env.unwrapped.physics)
    for _ in range(10):
        info = env.step(env.action_space.sample())[-1]
    assert env.unwrapped.task.distance(env.unwrapped.physics) == pytest.approx(info["normalised_distance"] * first)


def test_metadata_counts_frames_a_second(make):
    assert make().metadata["render_fps"] == 20


@pytest.mark.gl
def test_render_returns_frames_of_the_size_asked_for(make):
    env = make(render_mode="rgb_array", render_size=(96, 128))
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (96, 128, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 5


def test_registering_twice_is_no_error(task):
    face.register()
    assert gymnasium.spec(gym_id(task)).kwargs == {"task_name": task.name}


def test_any_task_can_be_made_by_its_name():
    env = gymnasium.make("ifo/Task-v0", task_name="push")
    observation, _ = env.reset(seed=3)
    same = gymnasium.make("ifo/Push-v0")
    assert np.array_equal(observation["position"], same.reset(seed=3)[0]["position"])
    env.close()
    same.close()


def test_several_environments_make_a_vector(task):
    name = gym_id(task)
    envs = gymnasium.make_vec(name, num_envs=2, vectorization_mode="sync", contexts="fixed")
    observation, _ = envs.reset(seed=0)
    assert observation["position"].shape == (2, task.model.nq)
    assert not np.array_equal(observation["position"][0], observation["position"][1])
    envs.close()


@pytest.mark.gl
@pytest.mark.parametrize("options", OPTIONS)
def test_stable_baselines3s_check_passes_which_goes_on_after_close(make, options):
    env = make(**options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_for_stable_baselines3(env, skip_render_check=False)
    env.close()
    assert env.unwrapped.physics._contexts is None
    env.close()


@pytest.mark.gl
def test_rendering_in_a_fork_is_refused_because_it_would_never_end(make, monkeypatch):
    env = make(pixels=True, render_mode="rgb_array")
    env.reset(seed=0)
    with monkeypatch.context() as patched:
        patched.setattr(gl, "_renders_in", os.getpid() + 1)  # as in a fork
        for use in (
            env.reset,
            env.render,
            lambda: make(pixels=True),
            lambda: RenderPool.of(env.unwrapped.task.task, 1),
        ):
            with pytest.raises(PlatformError, match=r"forked .* 'spawn' or 'forkserver'"):
                use()
        assert make().reset()[0], "without frames it works"
    assert env.render().std() > 5
