"""A Gymnasium environment as learners and rewards see it."""

from contextlib import closing

import numpy as np
import pytest

from artifacts import PlatformError, UsageError
from stages.config.demonstrations import Crop
from stages.environments.foreign import ForeignEnvironment, processes_for
from stages.environments.making import EnvironmentFault, episode_limit, frame_of, make_environment
from stages.environments.playing import play
from stages.environments.spec import EnvironmentSpec
from stages.rewards.own import OwnReward

HERE = "tests.stages.environments.slides"
RIGHT, LEFT = np.array([1.0, 0.0], np.float32), np.array([-1.0, 0.0], np.float32)


def spec(attribute="Slide", *, steps=10, frames=3, size=(16, 16), seed=1, crop=None, success="", **kwargs):
    return EnvironmentSpec(f"{HERE}:{attribute}", kwargs, seed, steps, frames, size, crop, None, success)


def opened(what, processes=1, rounds=1, shown=None):
    return closing(ForeignEnvironment(what, processes, rounds, OwnReward(), shown))


def always(action):
    return lambda seen: np.tile(action, (len(seen), 1))


@pytest.mark.parametrize("processes", [1, 2])
def test_episodes_run_in_lockstep_in_one_context_with_frames_and_a_clock(processes):
    with opened(spec(), processes, rounds=2) as env:
        assert env.num_envs == processes and env.rounds == 2 and env.has_clock
        assert env.observation_size == 3 and env.action_size == 2
        first = env.reset()
        np.testing.assert_array_equal(first[:, -1], 0)
        frames = play(env, always(RIGHT))
        assert frames.shape == (processes, 3, 16, 16, 3) and frames.dtype == np.uint8
        assert (frames[:, 0] != frames[:, 1]).any() and (frames[:, 1] != frames[:, 2]).any()
        np.testing.assert_array_equal(env.last.observation[:, -1], 1)
        np.testing.assert_allclose(env.last.observation[:, 0], first[:, 0] + 10 * 0.05 * 2, rtol=1e-5)
        assert env.moment.step == 0, "the next episode has begun"
        np.testing.assert_array_equal(env.moment.observation, first, "in the same context")
        x = first[0, 0] + 0.1 * np.arange(1, 11)
        outcomes = env.pop_outcomes()
        np.testing.assert_allclose(outcomes["env_return"], np.full(processes, (x - 1).sum()), rtol=1e-5)
        np.testing.assert_array_equal(outcomes["success"], np.ones(processes))
        assert env.pop_outcomes() == {}


def test_the_seed_selects_the_context():
    starts = []
    for seed in (1, 1, 2):
        with opened(spec(seed=seed)) as env:
            starts.append(float(env.reset()[0, 0]))
    assert starts[0] == starts[1] != starts[2]


def test_actions_are_scaled_to_the_environments_bounds():
    with opened(spec()) as env:
        start = env.reset()[0, 0]
        env.step(np.array([[0.5, 0.0]]))
        assert env.moment.observation[0, 0] == pytest.approx(start + 0.05)
        env.step(np.array([[7.0, 0.0]]))
        assert env.moment.observation[0, 0] == pytest.approx(start + 0.05 + 0.1), "clipped"


def test_an_environment_that_ends_early_stands_still_in_its_last_frame_without_reward():
    """Ending early must not save it from what the rest of the target costs."""
    with opened(spec(ends=True, steps=40, frames=5, limit=0)) as env:
        frames = play(env, always(LEFT))
        np.testing.assert_array_equal(frames[0, 2], frames[0, 3])
        np.testing.assert_array_equal(frames[0, 3], frames[0, 4])
        assert (frames[0, 1] != frames[0, 0]).any()
        assert env.last.observation[0, 0] == -1 and env.last.observation[0, -1] == 1
        returned = env.pop_outcomes()["env_return"][0]
    with opened(spec(steps=40, frames=5, limit=0)) as env:
        play(env, always(LEFT))
        assert env.pop_outcomes()["env_return"][0] < returned - 20


def test_an_episode_that_the_environment_cuts_short_is_no_error():
    with opened(spec(limit=4)) as env:
        assert play(env, always(RIGHT)).shape[1] == 3


def test_a_flag_named_success_counts_at_any_step_and_is_success_at_the_last():
    def there_and_back(seen):
        return np.tile(RIGHT if seen[0, -1] < 0.5 else LEFT, (len(seen), 1))

    for report, expected in (("success", 1.0), ("is_success", 0.0)):
        with opened(spec(steps=20, frames=3, limit=0, report=report)) as env:
            play(env, there_and_back)
            assert env.pop_outcomes()["success"][0] == expected
    with opened(spec(report="")) as env:
        play(env, always(RIGHT))
        assert set(env.pop_outcomes()) == {"env_return"} and env.pop_figures() == {}


@pytest.mark.parametrize("dictionary", [False, True])
def test_a_users_function_may_decide_about_success(dictionary):
    for steps, expected in ((10, 0.0), (25, 1.0)):
        what = spec(steps=steps, limit=0, success=f"{HERE}:is_far", dictionary=dictionary)
        with opened(what) as env:
            play(env, always(RIGHT))
            assert env.pop_outcomes()["success"][0] == expected
    message = r"step failed at .*slides.py:\d+ \(KeyError: 'goal'\)"
    with pytest.raises(EnvironmentFault, match=message), opened(spec(success=f"{HERE}:unsure")) as env:
        play(env, always(RIGHT))


@pytest.mark.parametrize(("name", "words"), [("absent", "cannot be loaded"), ("SIDE", "is a int, expected a function")])
def test_what_cannot_decide_about_success_is_refused(name, words):
    with pytest.raises(EnvironmentFault, match=f"--success {HERE}:{name}: {words}"):
        make_environment(spec(success=f"{HERE}:{name}"))


def test_only_frames_that_are_asked_for_are_rendered():
    with opened(spec(broken="render"), shown=range(0)) as env:
        play(env, always(RIGHT), frames=False)
    with opened(spec(), shown=range(1, 3)) as env:
        env.reset()
        with pytest.raises(ValueError, match="step 0 has no frame"):
            env.moment.frames()


def test_images_among_the_observations_are_left_out():
    with opened(spec(dictionary=True)) as env:
        assert env.observation_size == 3


def test_a_crop_is_reduced_by_area_averaging():
    image = np.arange(32 * 32 * 3, dtype=np.uint32).reshape(32, 32, 3).astype(np.uint8)
    whole = frame_of(image, spec())
    expected = image.reshape(16, 2, 16, 2, 3).astype(float).mean(axis=(1, 3))
    assert np.abs(whole - expected).max() <= 1
    np.testing.assert_array_equal(frame_of(image, spec(crop=Crop(4, 6, 16, 16))), image[6:22, 4:20])


@pytest.mark.parametrize(
    ("broken", "where", "processes"),
    [
        ("reset", "reset failed", 1),
        ("step", "step failed", 1),
        ("step", "step failed", 2),
        ("render", "render failed", 1),
        ("observation", "not finite", 1),
        ("exit", "step failed", 2),
    ],
)
def test_a_fault_of_the_environments_code_is_its_own_with_the_place(broken, where, processes):
    with pytest.raises(EnvironmentFault) as caught, opened(spec(broken=broken), processes) as env:
        play(env, always(RIGHT))
    message = str(caught.value)
    assert message.startswith(f"environment {HERE}:Slide: ") and where in message and "\n" not in message
    if broken not in ("observation", "exit"):
        assert "slides.py:" in message and f"cannot {broken}" in message


@pytest.mark.parametrize(
    ("what", "words"),
    [
        (spec("unbounded"), "expected a bounded Box"),
        (spec("discrete"), "actions are Discrete(3)"),
        (spec("blind"), "render_mode is None, expected 'rgb_array'"),
        (spec("number"), "is a int, expected a gymnasium.Env"),
        (spec("failing"), "(KeyError: 'model.xml')"),
        (spec("absent"), "has no absent"),
        (spec(colour="red"), "unexpected keyword argument 'colour'"),
        (EnvironmentSpec("no_such_module:Env"), "No module named 'no_such_module'"),
        (EnvironmentSpec("NoSuchEnv-v0"), "NoSuchEnv"),
    ],
)
def test_what_is_no_place_to_learn_in_is_refused_in_one_line(what, words):
    with pytest.raises(EnvironmentFault) as caught:
        make_environment(what).close()
    assert words in str(caught.value) and what.name in str(caught.value) and "\n" not in str(caught.value)


def test_a_render_that_returns_no_image_is_told():
    with (
        pytest.raises(UsageError, match=f"^environment {HERE}:Slide: render returns NoneType, expected uint8"),
        opened(spec(broken="frame")),
    ):
        pass
    with pytest.raises(UsageError, match="32x32 pixels is smaller than a frame of 48x48"), opened(spec(size=(48, 48))):
        pass


@pytest.mark.parametrize("killed", [[0, 1], [1]])
def test_a_process_that_ends_is_told_and_the_others_end(killed):
    with opened(spec(), 2) as env:
        env.reset()
        for index in killed:
            env._venv.processes[index].kill()
            env._venv.processes[index].join()
        with pytest.raises(PlatformError, match="--workers 1"):
            env.step(np.zeros((2, 2)))
    assert not any(process.is_alive() for process in env._venv.processes)


def test_an_interrupt_in_the_middle_of_a_step_ends_the_processes():
    with opened(spec(), 2) as env:
        env.reset()
        env._venv.step_async(np.zeros((2, 2), np.float32))
    assert not any(process.is_alive() for process in env._venv.processes)


def test_episodes_are_divided_evenly_among_processes():
    assert [processes_for(*given) for given in ((10, 2), (3, 2), (7, 4), (8, 16), (12, 5))] == [2, 1, 1, 8, 4]


def test_the_limit_is_that_of_the_environment():
    assert episode_limit(make_environment(spec(limit=7))) == 7
    assert episode_limit(make_environment(spec(limit=0))) is None
