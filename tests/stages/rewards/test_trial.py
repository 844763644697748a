"""What is said of a scene before any learning."""

import numpy as np
import pytest
import torch

from stages.environments.foreign import ForeignEnvironment
from stages.environments.playing import play
from stages.environments.spec import EnvironmentSpec
from stages.rewards.own import OwnReward
from stages.rewards.trial import Trial, hold_trial

GOOD = Trial(target=-0.2, still=-3.0, random=-2.5, target_motion=0.8, changes=True)


def test_a_scene_whose_target_ranks_first_has_no_problems():
    assert GOOD.problems() == [] and len(GOOD.lines()) == 1
    assert GOOD.metrics == {"return_target": -0.2, "return_still": -3.0, "return_random": -2.5, "target_motion": 0.8}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"changes": False}, "frames do not change"),
        ({"target_motion": 0.05}, "the target moves 0.05 times as much as the demonstrations"),
        ({"still": -0.21}, "ranks standing still (-0.21) as high as the target (-0.20)"),
        ({"random": -0.1}, "ranks random actions (-0.10) as high as the target (-0.20)"),
    ],
)
def test_each_problem_is_one_line_that_says_what_to_do(changed, words):
    (problem,) = Trial(**{**vars(GOOD), **changed}).problems()
    assert words in problem and "\n" not in problem
    assert any(advice in problem for advice in ("check", "train it on", "look at"))


class Pixels:
    """A network whose features are the pixels."""

    def encode(self, images):
        return images.flatten(1)


@pytest.fixture
def env():
    spec = EnvironmentSpec("tests.stages.environments.slides:Slide", {}, 5, 10, 4, (16, 16))
    env = ForeignEnvironment(spec, 1, 1, OwnReward())
    yield env
    env.close()


def arrays(target):
    images = torch.from_numpy(target).movedim(-1, 1) / 127.5 - 1
    moved = float((images - images[:1]).square().sum())
    features = images.flatten(1).numpy()
    scales = {"feature_scale": np.float32(moved), "image_scale": np.float32(moved)}
    return {"target_images": target.astype(np.float32), "target_features": features, **scales}


def test_returns_are_those_of_the_tracking_reward(env):
    right = np.tile(np.array([1.0, 0.0], np.float32), (1, 1))
    target = play(env, lambda seen: right)[0]
    trial = hold_trial(env, Pixels(), arrays(target), 0.0, 1.0, 3, "cpu")
    assert trial.target == pytest.approx(0, abs=1e-5) and trial.target_motion == pytest.approx(1, rel=1e-5)
    assert trial.still == pytest.approx(-2, rel=1e-4), "minus one per term"
    assert trial.changes and trial.problems() == []
    again = hold_trial(env, Pixels(), arrays(target), 0.0, 1.0, 3, "cpu")
    assert again == trial, "random actions follow from the seed"


def test_a_target_that_stands_still_is_told(env):
    still = play(env, lambda seen: np.zeros((1, 2), np.float32))[0]
    given = arrays(still) | {"feature_scale": np.float32(9.0), "image_scale": np.float32(9.0)}
    trial = hold_trial(env, Pixels(), given, 0.0, 1.0, 3, "cpu")
    said = " ".join(trial.problems())
    assert "the target moves 0.00 times" in said and "ranks standing still" in said
