"""Soft-DTW brings videos of different tempo to one, and does nothing to those that have one already."""

import dataclasses

import numpy as np
import pytest
import torch

from artifacts import PlatformError
from stages.collect_demos import playback
from stages.config.stages import TranslatorConfig
from stages.translation import alignment
from stages.translation.alignment import at_index, common_index
from stages.translation.training import ALIGN_AT, TranslatorTraining

T = 25


def sequences(times: np.ndarray, noise: float = 0.02) -> np.ndarray:
    """Features (n, T, 6) of something that moves along a curve and comes to rest, seen at `times` (n, T)."""
    s = np.minimum(times / 12, 1.0)
    shape = [s, s**2, np.sin(3 * s), np.cos(2 * s), np.zeros_like(s), np.ones_like(s)]
    return np.stack(shape, axis=-1) + noise * np.random.default_rng(1).normal(size=(*s.shape, 6))


def spread(times: np.ndarray, index: np.ndarray) -> float:
    """How much the videos differ, in frames, in what they show at one time: where they all still move."""
    shown = np.stack([np.interp(i, np.arange(T), t) for i, t in zip(index, times, strict=True)])
    moving = shown.mean(axis=0) < 9
    return float(shown[:, moving].std(axis=0).mean())


def test_videos_at_their_own_tempo_are_brought_to_one():
    times = playback(np.random.default_rng(0), 40, T, jitter=0.4)
    index = common_index(sequences(times))
    assert index.shape == times.shape
    assert (index[:, 0] == 0).all() and (np.diff(index, axis=1) >= 0).all() and (index <= T - 1).all()
    unaligned = spread(times, np.tile(np.arange(T), (40, 1)))
    assert unaligned > 0.7
    assert spread(times, index) < unaligned / 2


def test_videos_of_one_tempo_keep_it():
    times = np.tile(np.arange(T), (20, 1))
    index = common_index(sequences(times))
    assert np.abs(index - times)[:, :12].mean() < 0.5


def test_where_a_video_begins_is_no_matter_of_time():
    """A translation keeps something of its source's context in every frame: that must not be taken for progress."""
    times = playback(np.random.default_rng(0), 12, T, jitter=0.4)
    videos = sequences(times, noise=0.0)
    apart = 0.7 * np.random.default_rng(2).normal(size=(12, 1, 6))
    index = common_index(videos)
    np.testing.assert_allclose(common_index(videos + apart), index, atol=1e-6)
    assert spread(times, index) < spread(times, np.tile(np.arange(T), (12, 1))) / 2


def test_the_unit_of_features_and_what_never_changes_are_no_matter_of_time():
    times = playback(np.random.default_rng(0), 6, T, jitter=0.4)
    videos = sequences(times)
    index = common_index(videos)
    np.testing.assert_allclose(common_index(50 * videos), index, atol=1e-4)
    still = np.tile(np.random.default_rng(3).normal(size=(6, 1, 40)), (1, T, 1))
    np.testing.assert_allclose(common_index(np.concatenate([videos, still], axis=2)), index, atol=1e-4)
    np.testing.assert_allclose(common_index(videos.astype(np.float32)), index, atol=1e-2)


def test_noise_is_not_warped():
    """The clock among the features holds frames in place that nothing else tells apart."""
    videos = np.random.default_rng(4).normal(size=(16, T, 4))
    index = common_index(videos)
    late = np.abs(index - np.arange(T)).mean()
    assert late < 2.5, "soft-DTW without a clock moves them by more than three frames"


def test_the_common_tempo_is_found_from_some_sequences_spread_over_all(monkeypatch):
    import tslearn.barycenters

    monkeypatch.setattr(alignment, "REFERENCES", 3)
    seen, real = [], tslearn.barycenters.softdtw_barycenter

    def barycenter(sequences, **options):
        seen.append((sequences, options))
        return real(sequences, **options)

    monkeypatch.setattr(tslearn.barycenters, "softdtw_barycenter", barycenter)
    videos = sequences(playback(np.random.default_rng(0), 9, T, jitter=0.4))
    common_index(videos)
    (few, options), clocked = seen[0], alignment._with_clock(alignment._scaled(videos), np.arange(T))
    np.testing.assert_array_equal(few, clocked[[0, 4, 8]])
    assert options["gamma"] == alignment.SMOOTHING and options["max_iter"] == alignment.ROUNDS
    apart = np.square(np.stack(few) - np.mean(few, axis=0)).sum(axis=(1, 2))
    np.testing.assert_array_equal(options["init"], few[apart.argmin()])


def test_features_that_never_move_or_are_no_numbers_keep_equal_times():
    equal = np.tile(np.arange(5.0), (3, 1))
    still = common_index(np.ones((3, 5, 4), np.float32))
    np.testing.assert_array_equal(still, equal)
    assert still.dtype == np.float64
    broken = np.random.default_rng(0).normal(size=(3, 5, 4))
    broken[1, 2, 3] = np.nan
    np.testing.assert_array_equal(common_index(broken), equal)


def test_frames_of_a_video_are_on_average_one_apart_in_scaled_features():
    rng = np.random.default_rng(0)
    turned = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    videos = rng.normal(size=(40, T, 4)) * [1.0, 0.1, 0.04, 0.02] @ turned  # the last has 4e-4 of the first's variance
    scaled = alignment._scaled(videos)
    assert scaled.dtype == np.float64 and scaled.shape == (40, T, 3)
    assert not scaled[:, 0].any()
    apart = np.square(scaled[:, :, None] - scaled[:, None]).sum(axis=3)
    assert apart.mean() == pytest.approx(1.0, rel=0.02)
    assert alignment._scaled(np.random.default_rng(0).normal(size=(40, T, 30))).shape[2] == 16, "sixteen at most"


def test_a_clock_costs_what_the_last_frames_differ_by():
    scaled = np.random.default_rng(0).normal(size=(5, T, 2))
    scaled[:, -1] = [[3, 0], [-3, 0], [0, 3], [0, -3], [0, 0]]
    clocked = alignment._with_clock(scaled, np.arange(T))
    np.testing.assert_array_equal(clocked[..., :2], scaled)
    noise = 4 * 9 / 5
    two_late = np.square(clocked[:, 9, 2] - clocked[:, 7, 2])
    np.testing.assert_allclose(two_late, noise * (2 / alignment.EARLY_OR_LATE) ** 2)
    assert (clocked[:, 0, 2] == 0).all()


def test_values_between_frames_are_interpolated():
    values = torch.arange(12.0).reshape(2, 3, 2)
    index = np.array([[0.0, 0.5, 2.0], [0.25, 1.0, 1.75]])
    expected = torch.tensor([[[0, 1], [1, 2], [4, 5]], [[6.5, 7.5], [8, 9], [9.5, 10.5]]])
    torch.testing.assert_close(at_index(values, index), expected)


def test_playback_keeps_its_bounds():
    times = playback(np.random.default_rng(0), 500, T, jitter=0.4)
    steps = np.diff(times, axis=1)
    assert (times[:, 0] == 0).all() and (times <= T - 1).all() and (steps >= 0).all()
    free = steps[times[:, 1:] < T - 1]
    assert free.min() >= 0.6 - 1e-9 and free.max() <= 1.4 + 1e-9
    assert free.min() < 0.65 and free.max() > 1.35
    assert np.array_equal(playback(np.random.default_rng(0), 3, T, jitter=0.0), np.tile(np.arange(T), (3, 1)))


def test_without_tslearn_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setattr(alignment, "find_spec", lambda name: None)
    with pytest.raises(PlatformError, match=r"^--align dtw needs tslearn: .*ifo\[align\].* --align none$"):
        common_index(sequences(np.tile(np.arange(T), (3, 1))))


def test_training_pairs_the_frames_that_the_alignment_names():
    frames = torch.randint(0, 255, (12, 6, 16, 16, 3), dtype=torch.uint8)
    config = TranslatorConfig(steps=10, videos=4, frames=5, mirror=False, swap_colours=False, align="dtw")
    training = TranslatorTraining(config, frames, 0, "cpu")
    plain = training._batch()[0]
    for step in range(config.steps):
        training.step = step
        training.align()
        assert (training._index is not None) == (step >= ALIGN_AT[0] * config.steps)
    training.step = 0
    late = np.array([0, 2, 3, 4, 5, 5])
    training._index = np.tile(late, (12, 1))
    torch.testing.assert_close(training._batch()[0], plain[:, late[1:] - 1])
    resumed = TranslatorTraining(dataclasses.replace(config), frames, 0, "cpu")
    resumed.restore(training.state())
    torch.testing.assert_close(resumed._batch()[0], training._batch()[0])
