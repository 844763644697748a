"""The reward as a squared distance of some few numbers: the same reward where those numbers tell all."""

import numpy as np
import pytest
import torch

from stages.learners.reward import TrackingReward as TrackingProtocol
from stages.rewards import projected
from stages.rewards.projected import ProjectedTrackingReward, embedding, principal_components
from stages.rewards.tracking import TrackingReward, TrackingTarget, motion
from stages.translation.networks import CompactTranslator, to_images


def flat(frames):
    return frames.reshape(len(frames), -1) / 255.0


def made(stage, squares, ramp="none", **options):
    """A reward that tracks the mean of some videos of a moving square, and those videos."""
    videos = squares(row=4)
    examples = flat(videos.reshape(-1, *videos.shape[2:]))
    target = flat(videos.mean(axis=0))
    return ProjectedTrackingReward(stage.timing, flat, target, examples, ramp, **options), videos, target


@pytest.mark.parametrize("ramp", ["none", "quadratic"])
def test_following_the_target_returns_more_and_returns_are_the_cost(stage, squares, ramp):
    reward, videos, _ = made(stage, squares, ramp)
    assert isinstance(reward, TrackingProtocol)
    still = videos.copy()
    still[:] = videos[:, :1]
    followed, stood = stage.perform(reward, videos), stage.perform(reward, still)
    assert (followed.sum(axis=1) > 0.2 * stood.sum(axis=1)).all()
    steps, seen = stage.timing.control_steps, []
    seen.append(reward.tracked(stage.moment(0, still[:, 0])))
    for step in range(1, steps + 1):
        moment = stage.moment(step, still[:, min(step // 2, 5)])
        reward(moment, None)
        seen.append(reward.tracked(moment))
    apart = np.square(np.stack(seen, axis=1) - reward.targets).sum(axis=2)
    np.testing.assert_allclose(-0.5 * (reward.cost_weights * apart).sum(axis=1), stood.sum(axis=1))
    assert not reward.cost_weights[[0, 1, 3, steps]].any(), "the first frame, and steps without one, cost nothing"


def test_components_hold_what_varies_and_no_more(monkeypatch):
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.standard_normal((50, 3)))[0]
    examples = rng.standard_normal((40, 3)) * [3, 2, 1] @ basis.T + 5
    centre, found = principal_components(examples)
    np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(found @ found.T, basis @ basis.T, atol=1e-9)
    np.testing.assert_allclose(centre, examples.mean(axis=0))
    assert principal_components(examples, 2)[1].shape == (50, 2)
    monkeypatch.setattr(projected, "KEPT", 0.1)
    assert principal_components(examples)[1].shape == (50, 1)


@pytest.mark.parametrize("without", [(), ("img",), ("feat",)])
@pytest.mark.parametrize("blur", [0.0, 2.0])
def test_distances_of_embeddings_are_the_reward(squares, without, blur):
    videos = squares(row=4)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = CompactTranslator((16, 16), 16, 8, 16, 16).requires_grad_(False)
    images = to_images(torch.from_numpy(videos[0]))
    features = model.encode(images)
    scales = float(motion(features[None])), float(motion(images[None]))
    target = TrackingTarget(features, images, *scales, blur)
    embed = embedding(target, without, 2.0)
    shown = to_images(torch.from_numpy(videos[1:, 3]))
    apart = (embed(model.encode(shown), shown) - embed(features, images)[3]).square().sum(dim=1)
    reward = TrackingReward(model, target, np.ones(6), 2.0, without)(videos[1:, 3], 3)
    np.testing.assert_allclose(-apart.numpy(), sum(reward.values()), rtol=1e-3)


def test_what_no_demonstration_showed_costs_as_much_as_it_weighs(stage, squares):
    reward, videos, target = made(stage, squares, beyond=1.0)
    shown = videos[:2].copy()
    shown[:, :, :3, :3] = 255  # where the square never is
    first, second = (stage.perform(reward, each).sum(axis=1) for each in (videos[:2], shown))
    apart = [
        np.square(flat(each.reshape(-1, *each.shape[2:])).reshape(2, 6, -1) - target) for each in (videos[:2], shown)
    ]
    np.testing.assert_allclose(first, -apart[0][:, 1:].sum(axis=(1, 2)))
    np.testing.assert_allclose(second, -apart[1][:, 1:].sum(axis=(1, 2)))
    assert (second < first - 5).all()
    lighter, _, _ = made(stage, squares, beyond=0.25)
    saved = second - stage.perform(lighter, shown).sum(axis=1)
    assert (saved < 0.7 * (second - first)).all() and (saved > 0.8 * (second - first)).all()
    blind, _, _ = made(stage, squares, beyond=0)
    assert blind.targets.shape[1] == blind.components == lighter.targets.shape[1] - 1
    seen = stage.perform(blind, videos[:2]).sum(axis=1) - stage.perform(blind, shown).sum(axis=1)
    assert (seen < 0.1 * (first - second)).all()
