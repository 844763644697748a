"""What a reward from frames cannot notice by itself is warned of: another scene, no images, too short episodes."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.wrappers import TimeLimit

from stages.environments.timing import Timing
from stages.rewards.gym_wrapper import TranslationReward
from stages.rewards.scene_checks import MOST_UNLIKE, length_problem, stretch_problem, unlike
from stages.simulation.contexts import DISTRIBUTIONS
from stages.simulation.registry import learner_context
from stages.simulation.render import RenderPool
from stages.simulation.tasks.reach import Reach
from stages.translation.networks import to_images
from tests.stages.rewards.test_gym_wrapper import TARGET, Squares, draw, write


class Ending(Squares):
    """Terminates after some steps."""

    def __init__(self, steps, **options):
        super().__init__(**options)
        self._steps = steps

    def reset(self, **options):
        self._taken = 0
        return super().reset(**options)

    def step(self, action):
        self._taken += 1
        observation, reward, _, truncated, info = super().step(action)
        return observation, reward, self._taken == self._steps, truncated, info


class OtherCamera(Squares):
    def render(self):
        return 255 - super().render()[::-1, ::-1]


class NoImages(Squares):
    def render(self):
        return np.zeros((16, 16, 3), np.uint8)


class Frozen(Squares):
    def render(self):
        return draw(0)


class Wide(Squares):
    def render(self):
        return super().render().repeat(3, 0).repeat(4, 1)


@pytest.fixture
def squares(tmp_path):
    return write(tmp_path, TARGET)


def warned(env, path, episodes=2, **options):
    """The warnings of some episodes in which the square keeps up with the target."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        env = TranslationReward(env, path, **({"frame_every": 2} | options))
        for _ in range(episodes):
            env.reset(seed=0)
            for _ in range(12):
                if any(env.step(np.zeros(1, np.float32))[2:4]):
                    break
    return [str(warning.message) for warning in caught]


def test_what_is_right_is_not_warned_of(squares):
    assert warned(Squares(), squares) == []
    assert warned(Squares(scale=3), squares, pixels="camera") == []
    assert warned(TimeLimit(Squares(), 10), squares) == []


@pytest.mark.parametrize(
    ("env", "said"),
    [
        (OtherCamera, "first frame differs from the context frame"),
        (NoImages, "first frame has one color only"),
        (Frozen, "frames do not change during an episode"),
        (Wide, "64x48 pixels are squeezed to 16x16: crop them to 1:1"),
        (
            lambda: TimeLimit(Squares(), 7),
            "episodes of 7 steps end at frame 3 of 5 of the target, which takes 10 steps",
        ),
    ],
)
def test_each_trap_is_warned_of_once(squares, env, said):
    found = warned(env(), squares)
    assert sum(said in line for line in found) == 1, found
    assert all(line.startswith("TranslationReward: ") and "\n" not in line for line in found)


def test_a_limit_that_the_environment_declares_is_told_before_the_first_episode(squares):
    gymnasium.register("test/Short-v0", entry_point=Squares, max_episode_steps=4)
    with pytest.warns(UserWarning, match="episodes of 4 steps end at frame 2 of 5"):
        TranslationReward(gymnasium.make("test/Short-v0"), squares, 2)


@pytest.mark.filterwarnings("ignore:TranslationReward. the environment's frames do not change")
@pytest.mark.parametrize("steps", [1, 3, 4, 9, 10, 11])
def test_ending_early_does_not_pay(squares, steps):
    """It costs as much as standing still in the last frame until the end of the target."""

    class Stopping(Squares):
        def step(self, action):
            self._taken = getattr(self, "_taken", 0) + 1
            return super().step(action if self._taken <= steps else np.array([-1.0]))

    totals, terms = [], []
    for inner in (Ending(steps), Stopping()):
        env = TranslationReward(inner, squares, 2)
        env.reset(seed=0)
        total, parts = 0.0, np.zeros(2)
        for _ in range(12):
            _, reward, terminated, _, info = env.step(np.array([-0.3], np.float32))
            total += reward
            parts += info["reward_feat"], info["reward_img"]
            if terminated:
                break
        totals.append(total)
        terms.append(parts)
    assert totals[0] == pytest.approx(totals[1], rel=1e-5) and totals[1] < 0
    np.testing.assert_allclose(terms[0], terms[1], rtol=1e-5)


def test_a_truncated_episode_is_not_charged(squares):
    """Learners bootstrap from its value."""
    env = TranslationReward(TimeLimit(Squares(), 3), squares, 2)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="episodes of 3 steps"):
        rewards = [env.step(np.array([-1.0], np.float32))[1] for _ in range(3)]
    assert [reward < 0 for reward in rewards] == [False, True, False]


def test_lengths_and_shapes():
    timing = Timing.regular(49, 2)
    assert length_problem(None, timing) == "" and length_problem(48, timing) == ""
    assert "frame 23 of 24" in length_problem(47, timing)
    assert "frame 2 of 3 of the target, which takes 10 steps" in length_problem(9, Timing.spread(10, 4))
    assert stretch_problem((480, 640, 3), (48, 64)) == "" and stretch_problem((500, 510, 3), (48, 48)) == ""
    assert "crop them to 4:3" in stretch_problem((480, 480, 3), (48, 64))


@pytest.mark.gl
def test_contexts_are_told_apart_whatever_an_episode_begins_with():
    task, rng = Reach(), np.random.default_rng(0)
    with RenderPool.of(task, 1) as pool:

        def shown(seed, states):
            context = learner_context(task, seed, DISTRIBUTIONS["paper"])
            return pool.render(task.model_fields(context), states(context)[0][None])[0, 0]

        frame = shown(0, task.context_state)
        moves = to_images(torch.from_numpy(np.stack([frame, shown(0, lambda c: task.draw_states(rng, c))])))
        same = [unlike(shown(0, lambda c: task.draw_states(rng, c)), frame, moves) for _ in range(5)]
        other = [unlike(shown(seed, task.context_state), frame, moves) for seed in range(1, 9)]
    # The target here moves as little as the beginnings of episodes differ.
    assert max(same) < MOST_UNLIKE < min(other)
