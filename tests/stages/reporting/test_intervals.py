"""Intervals against published values."""

import numpy as np
import pytest

from stages.reporting.intervals import bootstrap_mean, wilson


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(10, 10, 0.7225, 1.0), (0, 10, 0.0, 0.2775), (81, 263, 0.2553, 0.3662)],  # the last from Newcombe (1998)
)
def test_wilson_interval(successes, trials, low, high):
    assert wilson(successes, trials) == pytest.approx((low, high), abs=1e-4)


def test_bootstrap_interval_of_a_normal_sample_is_near_the_textbooks():
    values = np.random.default_rng(0).normal(1.0, 0.5, 200)
    low, high = bootstrap_mean(values)
    half = 1.96 * values.std() / np.sqrt(200)
    assert low == pytest.approx(values.mean() - half, abs=0.01)
    assert high == pytest.approx(values.mean() + half, abs=0.01)
    assert bootstrap_mean(values) == (low, high), "the same every time"
