"""Confidence intervals, 95% throughout."""

from __future__ import annotations

import math

import numpy as np

Z = 1.959964  # of the normal distribution's central 95%
RESAMPLES = 10_000


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's score interval of a success rate."""
    if trials == 0:
        return 0.0, 1.0
    rate = successes / trials
    centre = (rate + Z**2 / (2 * trials)) / (1 + Z**2 / trials)
    half = Z * math.sqrt(rate * (1 - rate) / trials + Z**2 / (4 * trials**2)) / (1 + Z**2 / trials)
    return max(0.0, centre - half), min(1.0, centre + half)


def bootstrap_mean(values: np.ndarray) -> tuple[float, float]:
    """Percentile bootstrap interval of the mean of `values` (n,); the resampling is seeded."""
    values = np.asarray(values, np.float64)
    if len(values) < 2:
        return float(values.mean()), float(values.mean())
    drawn = np.random.default_rng(0).choice(values, (RESAMPLES, len(values)))
    low, high = np.percentile(drawn.mean(axis=1), [2.5, 97.5])
    return float(low), float(high)
