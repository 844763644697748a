"""Tracks of features, projected numbers and tuning on negatives equal their definitions."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from stages.rewards import negatives as negatives_module
from stages.rewards import pretrained
from stages.rewards.negatives import NegativeTuning
from stages.rewards.networks import PretrainedNetwork
from stages.rewards.pretrained import FeatureTrack, PretrainedReward, embedded_track, track
from stages.rewards.projected import (
    KEPT,
    MOST,
    ProjectedTrackingReward,
    embedded_translations,
    embedding,
    principal_components,
)
from stages.rewards.tracking import TrackingTarget
from stages.translation.networks import to_images

N, T = 6, 6


class Patches(torch.nn.Module):
    """Means of patches of 4x4 pixels: a feature map of 4x4."""

    def forward(self, x):
        return torch.nn.functional.avg_pool2d(x, 4)


@pytest.fixture
def network():
    return PretrainedNetwork("test", 16, {"patches": Patches(), "half": torch.nn.AvgPool2d(2)})


@pytest.fixture
def videos():
    return np.random.default_rng(0).integers(0, 256, (N, T, 16, 16, 3), dtype=np.uint8)


def patches(frames):
    """The features (..., 48) that the first layer has of frames."""
    images = np.moveaxis(frames / 127.5 - 1, -1, -3)
    return images.reshape(*images.shape[:-2], 4, 4, 4, 4).mean(axis=(-3, -1)).reshape(*frames.shape[:-3], 48)


def test_a_track_is_mean_and_spread_over_the_demonstrations(network, videos, monkeypatch):
    monkeypatch.setattr(pretrained, "CHUNK", 7)
    found, features = track(network, videos, "patches", "cpu"), patches(videos)
    assert found.layer == "patches" and found.mean.shape == (T, 48)
    np.testing.assert_allclose(found.mean, features.mean(axis=0), atol=1e-5)
    spread = features.std(axis=0)
    np.testing.assert_allclose(found.spread, np.maximum(spread, 0.1 * spread.mean()), atol=1e-5)
    few, held = features[:-2], features[-2:]  # a quarter of six
    floor = np.maximum(few.std(axis=0), 0.1 * few.std(axis=0).mean())
    error = np.square((held - few.mean(axis=0)) / floor).mean(axis=2).sum()
    moved = np.square((held - held[:, :1]) / floor).mean(axis=2).sum()
    assert found.quality == pytest.approx(error / moved, rel=1e-4)


def test_features_that_hardly_vary_are_divided_by_a_tenth_of_the_mean_spread(network, videos):
    videos[:, :, :4, :4] = 7
    found = track(network, videos, "patches", "cpu")
    spread = patches(videos).std(axis=0)
    assert (spread[:, [0, 16, 32]] < 1e-6).all()
    np.testing.assert_allclose(found.spread[:, 0], 0.1 * spread.mean(), rtol=1e-4)


def test_a_single_held_out_video_is_enough_to_compare_layers(network, videos):
    assert np.isfinite(track(network, videos[:3], "best", "cpu").quality)


def test_an_error_is_the_mean_square_in_spreads():
    made = FeatureTrack("x", torch.arange(6.0).reshape(2, 3), torch.tensor([[1.0, 2.0, 4.0], [1.0, 1.0, 1.0]]), 0.0)
    features = torch.tensor([[1.0, 3.0, 6.0], [5.0, 4.0, 5.0]])
    torch.testing.assert_close(made.error(features, 0), torch.tensor([1.0, (25 + 2.25 + 9 / 16) / 3]))
    torch.testing.assert_close(made.error(features, torch.tensor([0, 1])), torch.tensor([1.0, 4.0 / 3]))


@pytest.mark.parametrize("ramp", ["none", "quadratic"])
def test_the_reward_is_minus_the_weighted_error_over_the_frames(network, videos, stage, ramp, monkeypatch):
    monkeypatch.setattr(pretrained, "CHUNK", 2)
    made = track(network, videos, "patches", "cpu")
    got = stage.perform(PretrainedReward(stage.timing, network, made, ramp), videos[:3])
    weights = np.arange(T) ** 2 / np.mean(np.arange(T) ** 2) if ramp == "quadratic" else np.ones(T)
    apart = np.square((patches(videos[:3]) - made.mean.numpy()) / made.spread.numpy()).mean(axis=2)
    np.testing.assert_allclose(got, -(weights * apart / T)[:, 1:], rtol=1e-4)


def test_embeddings_are_features_over_their_mean_spread(network, videos, monkeypatch):
    monkeypatch.setattr(pretrained, "CHUNK", 5)
    made = track(network, videos, "half", "cpu")
    embed, goal, examples = embedded_track(network, videos[:2], made, "cpu")
    assert made.layer == "half" and made.mean.shape == (T, 12)
    halves = patches(videos).reshape(N, T, 3, 2, 2, 2, 2).mean(axis=(4, 6)).reshape(N, T, 12)
    scale = made.spread.numpy().mean(axis=0) * np.sqrt(T * 12)
    np.testing.assert_allclose(goal, halves.mean(axis=0) / scale, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(examples, halves[:2].reshape(-1, 12) / scale, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(embed(videos[3]), halves[3] / scale, rtol=1e-4, atol=1e-7)
    assert goal.dtype == examples.dtype == np.float64


def test_layers_are_averaged_to_a_grid_of_six():
    fine = PretrainedNetwork("test", 24, {"fine": torch.nn.Identity(), "coarse": torch.nn.AvgPool2d(8)})
    images = torch.rand(2, 3, 24, 24, generator=torch.Generator().manual_seed(0)) * 2 - 1
    found = dict(fine.features(images))
    assert found["fine"].shape == (2, 3 * 36) and found["coarse"].shape == (2, 27)
    torch.testing.assert_close(
        found["fine"], images.unflatten(2, (6, 4)).unflatten(4, (6, 4)).mean(dim=(3, 5)).flatten(1)
    )
    larger = images.repeat_interleave(2, dim=2).repeat_interleave(2, dim=3)
    torch.testing.assert_close(dict(fine.features(larger, "fine"))["fine"], found["fine"], rtol=1e-4, atol=1e-5)
    assert list(dict(fine.features(images, "fine"))) == ["fine"]
    assert fine.to("cpu").pieces.keys() == fine.pieces.keys() and fine.to("cpu").size == 24


def test_principal_components_are_those_of_a_singular_value_decomposition():
    rng = np.random.default_rng(0)
    examples = rng.normal(size=(40, 60)) * np.geomspace(1, 1e-3, 60) + 3
    centre, found = principal_components(examples)
    _, strengths, directions = np.linalg.svd(examples - examples.mean(axis=0), full_matrices=False)
    held = np.cumsum(strengths**2) / np.square(strengths).sum()
    count = int((held < KEPT).sum()) + 1
    assert found.shape == (60, min(count, MOST)) and 3 < count < MOST
    np.testing.assert_allclose(np.abs(directions[:count] @ found), np.eye(count), atol=1e-6)
    np.testing.assert_allclose(centre, examples.mean(axis=0))
    for few, size in ((examples[:4], 3), (examples[:, :2], 2)):
        assert principal_components(few)[1].shape[1] == size, "no more than there can be"
    assert principal_components(rng.normal(size=(50, 45)))[1].shape[1] == MOST


def test_numbers_that_are_tracked_are_components_and_what_is_beyond(stage):
    rng = np.random.default_rng(0)
    goal, examples = rng.normal(size=(T, 10)), rng.normal(size=(30, 10))
    seen = {}
    reward = ProjectedTrackingReward(
        stage.timing, lambda frames: seen["now"], goal, examples, "quadratic", most=3, beyond=0.5
    )
    centre, basis = principal_components(np.concatenate([examples, goal]), 3)
    assert reward.components == 3 and reward.finer is None
    np.testing.assert_allclose(reward.targets[2 * 4], [*((goal[4] - centre) @ basis), 0.0], atol=1e-12)
    seen["now"] = rng.normal(size=(2, 10))
    apart = seen["now"] - goal[4]
    inside = np.square(apart @ basis).sum(axis=1)
    beyond = np.square(apart).sum(axis=1) - inside
    weight = 16 / np.mean(np.arange(T) ** 2)
    np.testing.assert_allclose(reward.judge(4, None), -weight * (inside + 0.5 * beyond))
    tracked = reward.tracked(stage.moment(8, np.zeros((2, 1, 1, 3))))
    np.testing.assert_allclose(tracked[:, :3], (seen["now"] - centre) @ basis)
    np.testing.assert_allclose(tracked[:, 3], np.sqrt(0.5 * beyond))
    assert reward.cost_weights[8] == pytest.approx(2 * weight)
    without = ProjectedTrackingReward(stage.timing, None, goal, examples, most=3, beyond=0.0)
    assert without.targets.shape == (stage.timing.control_steps + 1, 3)
    again = ProjectedTrackingReward(stage.timing, None, goal, examples, finer=without)
    assert again.finer is without and again.targets.shape[1] == again.components + 1


@pytest.mark.parametrize("without", [(), ("feat",), ("img",)])
def test_an_embedding_is_features_and_images_over_roots_of_their_scales(without):
    generator = torch.Generator().manual_seed(0)
    features, images = torch.randn(2, 5, generator=generator), torch.rand(2, 3, 4, 4, generator=generator)
    made = TrackingTarget(torch.zeros(3, 5), torch.zeros(3, 3, 4, 4), 9.0, 25.0)
    found = embedding(made, without, 4.0)(features, images)
    parts = [] if "feat" in without else [features / 3]
    parts += [] if "img" in without else [2 * images.flatten(1) / 5]
    torch.testing.assert_close(found, torch.cat(parts, dim=1))


def test_components_are_of_the_first_translations(monkeypatch):
    monkeypatch.setattr("stages.rewards.projected.TRANSLATIONS", 2)
    rng = np.random.default_rng(0)
    arrays = {"features": rng.normal(size=(5, 3, 4)).astype(np.float32)}
    arrays["images"] = rng.integers(0, 256, (5, 3, 8, 8, 3), dtype=np.uint8)
    source = SimpleNamespace(read=lambda name, part: arrays[name][part])
    made = TrackingTarget(torch.randn(3, 4), torch.rand(3, 3, 8, 8), 2.0, 3.0)
    embed = embedding(made, (), 1.0)
    goal, examples = embedded_translations(source, embed, made)
    np.testing.assert_allclose(goal, embed(made.features, made.images), rtol=1e-6)
    images = to_images(torch.from_numpy(arrays["images"][:2].reshape(6, 8, 8, 3)))
    expected = embed(torch.from_numpy(arrays["features"][:2].reshape(6, 4)), images)
    assert examples.dtype == np.float64
    np.testing.assert_allclose(examples, expected, rtol=1e-6)


class Linear(torch.nn.Module):
    """Features that are linear in the pixels."""

    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.randn(4, 48, generator=torch.Generator().manual_seed(0)))

    def encode(self, images):
        return images.flatten(1) @ self.weight.T


@pytest.mark.parametrize("blur", [0.0, 1.0])
def test_negatives_are_to_be_as_much_farther_in_features_as_in_pixels(blur, monkeypatch):
    monkeypatch.setattr(negatives_module, "BATCH", 5)
    rng = np.random.default_rng(0)
    positives = rng.integers(0, 256, (7, 3, 4, 4, 3), dtype=np.uint8)
    images = to_images(torch.from_numpy(positives[0]))
    model = Linear()
    made = TrackingTarget(model.encode(images).detach(), images, 50.0, 20.0, blur)
    tuning = NegativeTuning(model, made, positives, 1, 3, "cpu")
    seen = rng.integers(0, 256, (2, 6, 4, 4, 3), dtype=np.uint8)
    for frame in (1, 2):
        tuning.see(frame, seen[frame - 1])
    with torch.no_grad():
        tuning.model.weight.add_(0.05)
    times, good, bad = tuning._batch(np.random.default_rng(1))
    assert set(times.tolist()) <= {1, 2}, "of times that the learner was seen at"
    farther, ranked, moved = [], [], []
    for time, one, other in zip(times, good, bad, strict=True):

        def distances(image, time=time):
            image = image[None]
            feature = (tuning.model.encode(image) - made.features[time]).square().sum() / 50
            pixels = made.image_error(image, int(time))[0] / (2 if blur else 1)
            return 3 * feature, 3 * pixels

        (near, close), (far, off) = distances(one), distances(other)
        farther.append(torch.relu((off - close).clamp_min(0) - (far - near)))
        if off > close:
            ranked.append(float(far > near))
        moved.append((tuning.model.encode(one[None]) - model.encode(one[None])).square().sum())
        assert any(np.array_equal(to_images(torch.from_numpy(each)), one) for each in positives[:, time])
        assert any(np.array_equal(to_images(torch.from_numpy(each)), other) for each in seen[time - 1])
    expected = torch.stack(farther).mean() + torch.stack(moved).mean() * 3 / 50
    torch.testing.assert_close(tuning._loss(np.random.default_rng(1)), expected, rtol=1e-4, atol=1e-5)
    gap = tuning._gap(times, good, bad)
    assert not len(tuning._gap(times, good, good)), "as near as the demonstrations is no negative"
    assert len(gap) == len(ranked) and float((gap > 0).float().mean()) == pytest.approx(np.mean(ranked))


def test_some_of_the_learners_frames_are_kept_spread_over_the_episodes(monkeypatch):
    monkeypatch.setattr(negatives_module, "SEEN", 3)
    tuning = NegativeTuning(Linear(), None, np.zeros((2, 3, 4, 4, 3), np.uint8), 1, 0, "cpu")
    frames = np.arange(9, dtype=np.uint8).reshape(9, 1, 1, 1) * np.ones((1, 4, 4, 3), np.uint8)
    tuning.see(2, frames)
    assert tuning._counts.tolist() == [0, 0, 3]
    assert tuning._seen[2, :3, 0, 0, 0].tolist() == [0, 4, 8]
    tuning.see(2, frames[:2])
    assert tuning._counts.tolist() == [0, 0, 5] and tuning._seen[2, 3:5, 0, 0, 0].tolist() == [0, 1]
