"""Intervals against published values and values computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stages.reporting.intervals import bootstrap_mean, wilson

Z = 1.959963984540054  # 97.5th percentile of the standard normal distribution


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # p = 1 or 0: the formula reduces to n / (n + z^2).
        (10, 10, 10 / (10 + Z**2), 1.0),
        (0, 10, 0.0, Z**2 / (10 + Z**2)),
        (1, 1, 1 / (1 + Z**2), 1.0),
        # p = 1/2: symmetric about 1/2, half-width z sqrt(n + z^2) / (2 (n + z^2)).
        (5, 10, 0.5 - Z / (2 * math.sqrt(10 + Z**2)), 0.5 + Z / (2 * math.sqrt(10 + Z**2))),
        (81, 263, 0.2553, 0.3662),  # Newcombe (1998)
        (15, 148, 0.0624, 0.1605),  # Newcombe (1998)
    ],
)
def test_wilson_interval(successes, trials, low, high):
    assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.parametrize("trials", [1, 3, 10, 17])
def test_the_end_of_an_interval_at_a_rate_of_zero_or_one_is_exact(trials):
    assert wilson(trials, trials)[1] == 1.0
    assert wilson(0, trials)[0] == 0.0


def test_wilson_interval_without_trials_says_nothing():
    assert wilson(0, 0) == (0.0, 1.0)
    with pytest.raises(ValueError):
        wilson(1, 0)


@pytest.mark.parametrize(
    ("values", "low", "high"),
    [
        # Means of resamples: 0, 1/2, 1 with probabilities 1/4, 1/2, 1/4.
        ([0, 1], 0, 1),
        # k/4, k binomial (4, 1/4): P(0) = .32 and P(k <= 2) = .949 < .975 < P(k <= 3) = .996.
        ([0, 0, 0, 1], 0, 0.75),
        # The same turned around.
        ([1, 1, 1, 0], 0.25, 1),
        # Of 27 resamples one has mean 1, and one has mean 4: 1/27 > .025.
        ([1, 2, 4], 1, 4),
    ],
)
def test_bootstrap_interval_of_few_values(values, low, high):
    assert bootstrap_mean(np.array(values)) == pytest.approx((low, high))


@pytest.mark.parametrize("values", [[0.3], [0.3, 0.3], [1.0] * 10, [0.1] * 7])
def test_equal_values_have_no_spread(values):
    low, high = bootstrap_mean(np.array(values))
    assert low == pytest.approx(values[0], abs=1e-15) and high == pytest.approx(values[0], abs=1e-15)


def test_truth_values_are_taken_as_numbers():
    assert bootstrap_mean(np.array([True, False])) == (0, 1)


def test_no_values_are_an_error():
    with pytest.raises(ValueError, match="n > 0"):
        bootstrap_mean(np.array([]))


def test_bootstrap_interval_of_a_normal_sample_is_near_the_textbooks():
    values = np.random.default_rng(0).normal(1.0, 0.5, 200)
    low, high = bootstrap_mean(values)
    half = Z * values.std() / np.sqrt(200)
    assert low == pytest.approx(values.mean() - half, abs=0.01)
    assert high == pytest.approx(values.mean() + half, abs=0.01)
    assert bootstrap_mean(values) == (low, high), "the same every time"
