"""The translation's reward on Gymnasium environments, ours and others."""

from __future__ import annotations

import re
import time
import warnings
from pathlib import Path

import cv2
import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

import stages.simulation.gym_registration  # noqa: F401 - registers ifo/Reach-v0
from artifacts import ArtifactError, UsageError, read_artifact, write_artifact
from stages.environments.simulated import Camera, SimulatedMoment
from stages.environments.timing import Timing
from stages.rewards.frames import time_weights
from stages.rewards.gym_wrapper import TranslationReward
from stages.rewards.tracking import TrackingTarget, motion
from stages.rewards.translation import BatchTranslationReward
from stages.simulation.contexts import DISTRIBUTIONS
from stages.simulation.registry import make_task
from stages.simulation.render import RenderPool
from stages.simulation.tasks.reach import Reach
from stages.translation.networks import load_translator, make_translator, to_images

ROOT = Path(__file__).parents[3]
SIZE = 16  # of the squares' frames
pytestmark = pytest.mark.filterwarnings("ignore:TranslationReward. the environment's frames do not change")


def write(folder, frames, task=None, contexts=None, name="x"):
    """A translation whose target is the video `frames` (T, H, W, 3), by a translator of random weights."""
    size = frames.shape[1:3]
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = make_translator("compact", size).eval().requires_grad_(False)
    images = to_images(torch.from_numpy(frames))
    features = model.encode(images)
    common = {"seed": 0, "command": "ifo", "environment": {}}
    translator = write_artifact(
        folder / f"{name}.translator.h5",
        "translator",
        {f"weights/{k}": v.numpy() for k, v in model.state_dict().items()},
        config={"stage": "train-translator", "preset": "quick", "arch": "compact", "size": list(size)},
        parents=[],
        **common,
    )
    return write_artifact(
        folder / f"{name}.translation.h5",
        "translation",
        {
            "context_frame": frames[0],
            "target_features": features.numpy(),
            "target_images": frames.astype(np.float32),
            "feature_scale": motion(features[None])[0].numpy(),
            "image_scale": motion(images[None])[0].numpy(),
            **{f"contexts/{key}": values for key, values in (contexts or {}).items()},
        },
        config={"stage": "translate", "preset": "quick", "task": task},
        parents=[translator],
        **common,
    )


class Squares(gymnasium.Env):
    """A square that moves right by one and what the action says; the agent sees where it is, and a picture."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - as Gymnasium has it
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self, render_mode="rgb_array", scale=1):
        self.render_mode, self._scale = render_mode, scale
        shape = (SIZE * scale, SIZE * scale, 3)
        self.observation_space = gymnasium.spaces.Dict(
            {
                "place": gymnasium.spaces.Box(0.0, 100.0, (1,), np.float32),
                "camera": gymnasium.spaces.Box(0, 255, shape, np.uint8),
            }
        )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._place = np.zeros(1, np.float32)
        return self._observation(), {}

    def step(self, action):
        self._place = np.minimum(self._place + 1.0 + action, 100.0).astype(np.float32)
        return self._observation(), 7.0, False, False, {"mine": 1}

    def render(self):
        return draw(self._place[0]).repeat(self._scale, 0).repeat(self._scale, 1)

    def _observation(self):
        return {"place": self._place.copy(), "camera": self.render()}


def draw(place):
    frame = np.full((SIZE, SIZE, 3), 40, np.uint8)
    left = int(place)
    frame[6:10, left : left + 4] = 230
    return frame


gymnasium.register("test/Squares-v0", entry_point=Squares, max_episode_steps=20)
TARGET = np.stack([draw(2 * j) for j in range(6)])


@pytest.fixture
def squares(tmp_path):
    return write(tmp_path, TARGET)


def episode(env, speed, steps):
    env.reset(seed=0)
    return [env.step(np.array([speed - 1], np.float32)) for _ in range(steps)]


def test_another_environment_is_rewarded_for_following_the_target(squares):
    env = TranslationReward(Squares(), squares, frame_every=2)
    following = [step[1] for step in episode(env, 1.0, 14)]
    np.testing.assert_allclose(following, 0.0, atol=1e-5)
    still = [step[1] for step in episode(env, 0.0, 14)]
    assert [k for k, reward in enumerate(still, 1) if reward < 0] == [2, 4, 6, 8, 10], "frames 1 to 5, no further"
    # R_feat returns -1, R_img -1, and once more blurred; quick weighs R_img twice.
    assert sum(still) == pytest.approx(-1 - 2 * 2, rel=1e-4)
    assert [step[1] for step in episode(env, 0.0, 14)] == still, "a new episode starts at frame 0"


def test_info_tells_the_environments_reward_and_both_terms(squares):
    env = TranslationReward(Squares(), squares, frame_every=1, blur=0.0, image_weight=0.5)
    _, reward, _, _, info = episode(env, 0.0, 3)[-1]
    assert info["env_reward"] == 7.0 and info["mine"] == 1
    assert reward == pytest.approx(info["reward_feat"] + info["reward_img"])
    target = TrackingTarget.of(read_artifact(squares), 0.0)
    image = to_images(torch.from_numpy(TARGET[:1]))
    assert info["reward_img"] == pytest.approx(-0.5 * float(target.image_error(image, 3)), rel=1e-5)
    alone = episode(TranslationReward(Squares(), squares, 1, without=("feat",)), 0.0, 3)[-1][-1]
    assert alone["reward_feat"] == 0.0 and alone["reward_img"] < 0


def test_late_frames_weigh_more_under_a_quadratic_ramp(squares):
    plain, ramped = (
        [s[1] for s in episode(TranslationReward(Squares(), squares, 1, ramp=r), 0.0, 5)] for r in ("none", "quadratic")
    )
    j = np.arange(1, 6)
    np.testing.assert_allclose(np.divide(ramped, plain), j**2 / np.mean(np.arange(6) ** 2), rtol=1e-5)


def test_the_ramp_and_the_time_between_frames_are_the_tasks(tmp_path):
    env = TranslationReward(Squares(), write(tmp_path, TARGET, task="strike"))
    task = make_task("strike")
    assert task.ramp == "quadratic" and task.frame_every == 2
    np.testing.assert_array_equal(env._reward.weights, time_weights("quadratic", len(TARGET)))
    rewarded = [k for k, step in enumerate(episode(env, 0.0, 12), 1) if step[1] < 0]
    assert rewarded == [2, 4, 6, 8, 10]


@pytest.mark.parametrize("pixels", [None, "camera"])
def test_larger_frames_are_reduced_by_areas(squares, pixels):
    env, large = (TranslationReward(Squares(scale=k), squares, 1, pixels=pixels) for k in (1, 3))
    one, other = ([step[1] for step in episode(e, 0.7, 5)] for e in (env, large))
    np.testing.assert_allclose(one, other, rtol=1e-5)

    class Noise(Squares):
        def render(self):
            return np.random.default_rng(0).integers(0, 255, (40, 52, 3), dtype=np.uint8)

    noise = TranslationReward(Noise(), squares, 1, without=("feat",), blur=0.0, image_weight=1.0)
    with pytest.warns(UserWarning, match=r"52x40 pixels are squeezed to 16x16|differs from the context frame"):
        reward = episode(noise, 0.0, 1)[-1][1]
    reduced = cv2.resize(Noise().render(), (SIZE, SIZE), interpolation=cv2.INTER_AREA)
    error = TrackingTarget.of(read_artifact(squares), 0.0).image_error(to_images(torch.from_numpy(reduced[None])), 1)
    assert reward == pytest.approx(-float(error), rel=1e-5)


@pytest.mark.parametrize("pixels", [None, "camera"])
def test_gymnasiums_own_checks_pass(squares, pixels):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*different from the unwrapped version.*")
        check_env(TranslationReward(gymnasium.make("test/Squares-v0"), squares, 2, pixels=pixels))


def test_a_spec_makes_the_same_environment_again(squares):
    env = TranslationReward(gymnasium.make("test/Squares-v0"), squares, 2, without=["feat"])
    again = env.spec.make()
    assert isinstance(again, TranslationReward)
    assert [step[1] for step in episode(again, 0.3, 8)] == [step[1] for step in episode(env, 0.3, 8)]


@pytest.mark.parametrize(
    ("env", "options", "said"),
    [
        ({}, {}, "frame_every="),
        ({}, {"frame_every": 0}, "frame_every=0"),
        ({"render_mode": None}, {"frame_every": 1}, "expected 'rgb_array'"),
        ({}, {"frame_every": 1, "pixels": "place"}, "uint8; keys with images: camera"),
        ({}, {"frame_every": 1, "pixels": "eye"}, "pixels='eye'"),
        ({}, {"frame_every": 1, "ramp": "steep"}, "ramp='steep'"),
        ({}, {"frame_every": 1, "without": ("feat", "img")}, "without="),
        ({}, {"frame_every": 1, "device": "gpu"}, "--device gpu"),
    ],
)
def test_what_cannot_work_is_said_in_one_line(squares, env, options, said):
    with pytest.raises(UsageError, match=re.escape(said)) as error:
        TranslationReward(Squares(**env), squares, **options)
    assert "\n" not in str(error.value)


def test_frames_smaller_than_the_translators_are_refused(tmp_path):
    large = write(tmp_path, TARGET.repeat(2, 1).repeat(2, 2))
    with pytest.raises(UsageError, match="16x16 pixels, expected 32x32"):
        TranslationReward(Squares(), large, 1, pixels="camera")
    drawn = TranslationReward(Squares(), large, 1)
    with pytest.raises(UsageError, match="16x16 pixels, expected 32x32"):
        drawn.reset()


def test_a_translation_without_its_translator_is_refused(tmp_path, squares):
    (tmp_path / "x.translator.h5").unlink()
    with pytest.raises(ArtifactError, match="translator"):
        TranslationReward(Squares(), squares, 1)


@pytest.fixture(scope="module")
def reach(tmp_path_factory):
    """A task, one of its contexts, and a translation into it."""
    task = Reach()
    context = task.draw_contexts(np.random.default_rng(0), 1, DISTRIBUTIONS["paper"])
    qpos = context["initial_qpos"] + np.linspace(0, 1, task.frames)[:, None] * np.array([1.0, -0.5, 0.5])
    with RenderPool.of(task, 1) as pool:
        frames = pool.render(task.model_fields(context), qpos[None])[0]
        path = write(tmp_path_factory.mktemp("reach"), frames, "reach", context, "reach-c0")
        yield task, context, path, pool


@pytest.mark.gl
@pytest.mark.parametrize("pixels", ["pixels", None])
def test_it_is_the_reward_that_learn_policy_learns_from(reach, pixels):
    task, context, path, pool = reach
    options = {"pixels": True} if pixels else {"render_mode": "rgb_array", "render_size": task.frame_size}
    inner = gymnasium.make("ifo/Reach-v0", contexts=lambda rng, n: context, **options)
    env = TranslationReward(inner, path, pixels=pixels)
    source = read_artifact(path)
    model, target = load_translator(source.parent("translator")), TrackingTarget.of(source, 4.0)
    timing, camera = Timing.regular(task.control_steps, task.frame_every), Camera(task, context, pool)
    batch = BatchTranslationReward(timing, model, target, image_weight=2.0, ramp=task.ramp)
    env.reset(seed=1)
    env.action_space.seed(1)
    got, expected = [], []
    for step in range(1, task.control_steps + 1):
        action = env.action_space.sample()
        got.append(env.step(action)[1])
        state = env.unwrapped.physics.task_state()
        expected.append(float(batch(SimulatedMoment(step, state, context, np.zeros((1, 1)), camera), action[None])[0]))
    env.close()
    assert np.count_nonzero(got) == task.frames - 1
    np.testing.assert_allclose(got, expected, rtol=1e-5)


@pytest.mark.gl
def test_the_documented_example_learns(reach, monkeypatch, tmp_path):
    path = reach[2]
    text = (ROOT / "docs/how-to/other-libraries.md").read_text(encoding="utf-8")
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", text, re.S) if "TranslationReward" in block)
    assert len([line for line in code.splitlines() if line]) <= 10
    (tmp_path / "runs").symlink_to(path.parent)
    monkeypatch.chdir(tmp_path)
    short, changes = re.subn(r"total_timesteps=[\d_]+", "total_timesteps=200", code)
    assert changes == 1
    short, changes = re.subn(r'"MultiInputPolicy", env', '"MultiInputPolicy", env, n_steps=100, batch_size=50', short)
    assert changes == 1
    start = time.monotonic()
    scope: dict = {}
    exec(compile(short, "other-libraries.md", "exec"), scope)
    assert time.monotonic() - start < 15
    assert scope["model"].num_timesteps == 200
    scope["env"].close()
