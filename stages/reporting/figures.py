"""The figures of an evaluation."""

from __future__ import annotations

from typing import Any

import numpy as np

from stages.reporting.intervals import bootstrap_mean, wilson


def figures(deterministic: np.ndarray, stochastic: np.ndarray, threshold: float) -> dict[str, Any]:
    """Means and rates over runs, each with its 95% interval: Wilson's for the success of runs, else the bootstrap's.

    The paper's criterion gives one verdict per run: the mean over episodes of the stochastic policy's normalized final
    distance is below the threshold. Beside it stands the stricter success rate of the deterministic policy's episodes.
    The bootstrap resamples runs; if there is only one, its episodes.

    Args:
        deterministic: Normalized final distances (R, E) of E episodes of each of R runs' deterministic policies.
        stochastic: The same of the stochastic policies, which decide the success of a run.
        threshold: The task's.
    """
    succeeded = stochastic.mean(axis=1) < threshold
    ended_near = deterministic < threshold

    return {
        **_resampled(deterministic),
        "normalised_distance": float(deterministic.mean()),
        "normalised_distance_interval": _interval(deterministic),
        "normalised_distance_stochastic": float(stochastic.mean()),
        "normalised_distance_stochastic_interval": _interval(stochastic),
        "per_run_distance": [float(value) for value in stochastic.mean(axis=1)],
        "succeeded": int(succeeded.sum()),
        "success_paper": float(succeeded.mean()),
        "success_paper_interval": wilson(int(succeeded.sum()), len(succeeded)),
        "success_deterministic": float(ended_near.mean()),
        "success_deterministic_interval": _interval(ended_near),
    }


def means(outcomes: dict[str, np.ndarray]) -> dict[str, Any]:
    """Mean of each outcome (R, E) of R runs with E episodes, with its 95% interval, which the bootstrap gives.

    Args:
        outcomes: Outcomes by name.
    """
    found = _resampled(next(iter(outcomes.values())))
    for name, values in outcomes.items():
        found |= {name: float(values.mean()), f"{name}_interval": _interval(values)}
        found[f"per_run_{name}"] = [float(value) for value in values.mean(axis=1)]
    return found


def _resampled(outcomes: np.ndarray) -> dict[str, Any]:
    return {"runs": len(outcomes), "resampled": "runs" if len(outcomes) > 1 else "episodes"}


def _interval(values: np.ndarray) -> tuple[float, float]:
    return bootstrap_mean(values.mean(axis=1) if len(values) > 1 else values[0])
