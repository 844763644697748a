"""LeRobot's feature statistics, per episode and for the whole dataset. They are exact because pixels are bytes."""

from __future__ import annotations

from typing import Any

import numpy as np

QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
LEVELS = 256


def of_numbers(values: np.ndarray) -> dict[str, list[Any]]:
    """Statistics of a scalar feature (F,): one value per statistic, and the number of frames as `count`."""
    values = np.asarray(values, float)
    quantiles = np.quantile(values, QUANTILES)
    figures = {"min": values.min(), "max": values.max(), "mean": values.mean(), "std": values.std()}
    named = {f"q{round(100 * at):02d}": value for at, value in zip(QUANTILES, quantiles, strict=True)}
    return (
        {name: [float(value)] for name, value in figures.items()}
        | {"count": [len(values)]}
        | {name: [float(value)] for name, value in named.items()}
    )


def levels_in(frames: np.ndarray) -> np.ndarray:
    """Per-channel histogram (3, 256) of the pixel levels in frames (..., 3), uint8."""
    flat = frames.reshape(-1, 3)
    return np.stack([np.bincount(flat[:, channel], minlength=LEVELS) for channel in range(3)])


def of_pictures(counts: np.ndarray, frames: int) -> dict[str, list[Any]]:
    """Image statistics, (3, 1, 1) each, in [0, 1], from a histogram (3, 256); the number of frames as `count`."""
    levels = np.arange(LEVELS) / (LEVELS - 1)
    total = counts.sum(axis=1)
    mean = counts @ levels / total
    there = counts > 0
    figures = {
        "min": levels[there.argmax(axis=1)],
        "max": levels[LEVELS - 1 - there[:, ::-1].argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(counts @ levels**2 / total - mean**2, 0)),
    }
    heaped = counts.cumsum(axis=1)
    for at in QUANTILES:
        figures[f"q{round(100 * at):02d}"] = levels[(heaped >= at * total[:, None]).argmax(axis=1)]
    return {name: values.reshape(3, 1, 1).tolist() for name, values in figures.items()} | {"count": [frames]}
