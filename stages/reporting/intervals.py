"""95% confidence intervals."""

from __future__ import annotations

import numpy as np
from scipy import stats

LEVEL = 0.95
RESAMPLES = 10_000


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Wilson score interval of a success rate; (0, 1) without trials.

    Raises:
        ValueError: More successes than trials.
    """
    if trials == 0 == successes:
        return 0.0, 1.0
    found = stats.binomtest(int(successes), int(trials)).proportion_ci(LEVEL, "wilson")
    return float(found.low), float(found.high)


def bootstrap_mean(values: np.ndarray) -> tuple[float, float]:
    """Percentile bootstrap interval of the mean of `values` (n,); of a single value, that value twice.

    The generator of the resampling is seeded, so that equal values have equal intervals. Percentile, not BCa: where all
    values are equal, which is the usual case of a success rate, BCa is not defined.

    Raises:
        ValueError: There are no values.
    """
    values = np.asarray(values, np.float64)
    if values.ndim != 1 or not len(values):
        raise ValueError(f"expected values of shape (n,), n > 0; got {values.shape}")
    if len(values) == 1:
        return float(values[0]), float(values[0])
    found = stats.bootstrap(
        (values,),
        np.mean,
        n_resamples=RESAMPLES,
        confidence_level=LEVEL,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    return float(found.confidence_interval.low), float(found.confidence_interval.high)
