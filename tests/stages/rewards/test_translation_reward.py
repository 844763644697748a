"""The reward is Sec. V.A's, scaled to order one."""

import dataclasses

import numpy as np
import pytest
import torch

from stages.environments.simulated import Camera, SimulatedMoment
from stages.environments.timing import Timing
from stages.rewards.state import OracleReward
from stages.rewards.tracking import TrackingTarget, gaussian, motion
from stages.rewards.translation import BatchTranslationReward
from stages.simulation.contexts import DISTRIBUTIONS
from stages.simulation.render import RenderPool
from stages.simulation.task import State
from stages.simulation.tasks.reach import Reach
from stages.translation.networks import CompactTranslator, to_images

pytestmark = pytest.mark.gl


@pytest.fixture(scope="module")
def scene():
    """A task, one context, a path of joint angles and the frames that it shows."""
    task = Reach()
    context = task.draw_contexts(np.random.default_rng(0), 1, DISTRIBUTIONS["paper"])
    qpos = context["initial_qpos"] + np.linspace(0, 1, task.frames)[:, None] * np.array([1.0, -0.5, 0.5])
    pool = RenderPool.of(task, 1)
    frames = pool.render(task.model_fields(context), qpos[None])[0]
    yield task, context, qpos, frames, pool
    pool.close()


def at_rest(qpos):
    """A state whose joints are at qpos (n, 3); the hand's place does not matter here."""
    n = len(qpos)
    zeros = np.zeros_like(qpos)
    return State(qpos=qpos, qvel=zeros, site_xpos=np.zeros((n, 1, 3)), time=np.zeros(n), ctrl=zeros)


def make(scene, **options):
    task, _, _, frames, _ = scene
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = CompactTranslator((48, 48), 16, 8, 16, 16).requires_grad_(False)
    images = to_images(torch.from_numpy(frames))
    features = model.encode(images)
    target = TrackingTarget(features, images, float(motion(features[None])), float(motion(images[None])))
    return (
        BatchTranslationReward(Timing.regular(task.control_steps, task.frame_every), model, target, **options),
        model,
        target,
    )


def moment(scene, step, state):
    task, context, _, _, pool = scene
    return SimulatedMoment(step, state, context, np.zeros((len(state.qpos), 1)), Camera(task, context, pool))


def episode(reward, scene, qpos):
    """Rewards (50, n) along frames' joint angles (T, 3), given to a batch of two equal simulations."""
    task, got = scene[0], []
    for step in range(1, task.control_steps + 1):
        at = qpos[min(step // task.frame_every, task.frames - 1)]
        state = at_rest(np.tile(at, (2, 1)))
        got.append(reward(moment(scene, step, state), np.zeros((2, 3))))
    return np.stack(got)


def test_following_the_target_returns_nothing_and_standing_still_minus_one_a_term(scene):
    task, _, qpos, _, _ = scene
    reward, _, _ = make(scene)
    np.testing.assert_allclose(episode(reward, scene, qpos), 0.0, atol=1e-6)
    reward.terms()
    still = episode(reward, scene, np.tile(qpos[0], (task.frames, 1)))
    np.testing.assert_allclose(still.sum(axis=0), -2.0, rtol=1e-4)
    terms = reward.terms()
    assert terms["feat"] == pytest.approx(-1.0, rel=1e-4)
    assert terms["img"] == pytest.approx(-1.0, rel=1e-4)
    assert terms["return"] == pytest.approx(-2.0, rel=1e-4)


def test_reward_equals_its_definition_at_one_frame(scene):
    _, _, qpos, frames, _ = scene
    reward, model, target = make(scene, image_weight=0.25)
    state = at_rest(qpos[None, 3])
    got = reward(
        moment(scene, 20, state), np.zeros((1, 3))
    )  # frame 10, while the arm is where the target was at frame 3
    image = to_images(torch.from_numpy(frames[3]))
    feat = (model.encode(image[None])[0] - target.features[10]).square().sum() / target.feature_scale
    img = (image - target.images[10]).square().sum() / target.image_scale
    np.testing.assert_allclose(got, [-float(feat) - 0.25 * float(img)], rtol=1e-5)


def test_only_steps_that_a_frame_shows_are_rewarded(scene):
    task, _, qpos, _, _ = scene
    reward, _, _ = make(scene)
    still = episode(reward, scene, np.tile(qpos[0], (task.frames, 1)))
    rewarded = np.flatnonzero(np.abs(still[:, 0]) > 0) + 1  # control steps, counted from 1
    assert set(rewarded) <= set(range(2, 50, 2))
    assert 48 in rewarded


@pytest.mark.parametrize(("without", "left"), [("feat", "img"), ("img", "feat")])
def test_a_term_can_be_left_out(scene, without, left):
    task, _, qpos, _, _ = scene
    reward, _, _ = make(scene, without=(without,))
    still = episode(reward, scene, np.tile(qpos[0], (task.frames, 1)))
    np.testing.assert_allclose(still.sum(axis=0), -1.0, rtol=1e-4)
    assert set(reward.terms()) == {left, "return"}


def test_the_quadratic_ramp_weights_late_frames_and_keeps_the_mean(scene):
    task, _, qpos, _, _ = scene
    plain, _, _ = make(scene)
    ramped, _, _ = make(scene, ramp="quadratic")
    path = np.tile(qpos[0], (task.frames, 1))
    ratio = episode(ramped, scene, path)[1::2][:24, 0] / episode(plain, scene, path)[1::2][:24, 0]
    j = np.arange(1, 25)
    np.testing.assert_allclose(ratio, j**2 / np.mean(np.arange(25) ** 2), rtol=1e-5)


def test_the_oracle_rewards_the_final_distance_alone():
    task = Reach()
    contexts = task.draw_contexts(np.random.default_rng(1), 3, DISTRIBUTIONS["paper"])
    reward = OracleReward(task)
    goal = np.concatenate([contexts["goal"], np.zeros((3, 1))], axis=1)[:, None]

    def at(step, offset):
        state = dataclasses.replace(at_rest(np.zeros((3, 3))), site_xpos=goal + np.array([offset, 0, 0]))
        return SimulatedMoment(step, state, contexts, np.zeros((3, 1)))

    np.testing.assert_array_equal(reward(at(1, 0.8), np.zeros((3, 3))), 0.0)
    np.testing.assert_array_equal(reward(at(49, 0.5), np.zeros((3, 3))), 0.0)
    np.testing.assert_allclose(reward(at(50, 0.2), np.zeros((3, 3))), -0.25)


def square(column: int) -> torch.Tensor:
    """An image (1, 3, 48, 48) of a small white square on black."""
    image = torch.full((1, 3, 48, 48), -1.0)
    image[..., 20:23, column : column + 3] = 1.0
    return image


def test_blurred_images_tell_how_far_off_something_is_where_plain_ones_do_not():
    images = torch.cat([square(5), square(20)])
    scale = float(motion(images[None]))
    plain, blurred = (TrackingTarget(torch.zeros(2, 1), images, 1.0, scale, blur) for blur in (0.0, 4.0))
    offsets = [square(20 + k) for k in (0, 4, 7, 10)]
    without = [float(plain.image_error(image, 1)) for image in offsets]
    errors = [float(blurred.image_error(image, 1)) for image in offsets]
    assert without[0] == 0.0 and without[1] == pytest.approx(without[2]) == pytest.approx(without[3])
    assert errors[0] == pytest.approx(0.0, abs=1e-6)
    assert errors[1] < 0.8 * errors[2] < 0.8 * errors[3]
    still = float(blurred.image_error(square(5), 1))
    assert still == pytest.approx(2.0, rel=1e-4), "each of the two has its own scale: standing still costs one"


def test_a_gaussian_keeps_flat_images_and_the_sum_of_others():
    flat = torch.full((2, 3, 20, 30), 0.3)
    torch.testing.assert_close(gaussian(flat, 2.5), flat)
    spot = torch.zeros(1, 1, 41, 41)
    spot[0, 0, 20, 20] = 1.0
    spread = gaussian(spot, 2.0)
    assert float(spread.sum()) == pytest.approx(1.0, abs=1e-5)
    x = torch.arange(41.0) - 20
    assert float((spread[0, 0].sum(dim=0) * x**2).sum()) == pytest.approx(4.0, rel=0.03)
