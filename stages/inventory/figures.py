"""The key figures of an artifact, from its manifest; anyone may have written the file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from artifacts import ArtifactError, read_artifact
from artifacts.glance import Glance
from artifacts.survey import FRAMES

GROUPS = ("metrics", "summary")  # of datasets in files that record no figures in their manifest
CURVE = "curve"
MOST_VALUES = 100_000  # of a dataset; a learning curve is shorter
MOST_DATASETS = 200


def figures_of(item: Glance) -> dict[str, Any]:
    """Return the figures that the stage printed, JSON-ready, and the number and size of demonstrations.

    Files by an older ifo do not record them: their small datasets of metrics are read instead.
    """
    found = dict(item.manifest.summary) or _stored_figures(item)
    shape = item.shapes.get(FRAMES, ())
    if item.kind == "demos" and len(shape) == 5:
        count, frames, height, width, _ = shape
        found |= {"demos": count, "video_frames": frames, "height": height, "width": width}
    return found


def key_figure(kind: str, figures: Mapping[str, Any]) -> str:
    """Return in a few words how good an artifact of a kind is, or how much it holds; empty if that is not known."""
    numbers = {
        name: float(value)
        for name, value in figures.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    }
    return ", ".join(part for say in PARTS.get(kind, ()) if (part := say(numbers)))


def _stored_figures(item: Glance) -> dict[str, Any]:
    """Return the single values in the groups of metrics, and the last values of learning curves."""
    figures: dict[str, Any] = {}
    try:
        artifact = read_artifact(item.path)
        names = [name for group in (*GROUPS, CURVE) for name in artifact.names(f"{group}/")][:MOST_DATASETS]
        described = artifact.describe()
        for name in names:
            shape, dtype = described[name]
            group, _, key = name.partition("/")
            if dtype.kind not in "fiu" or math.prod(shape) > MOST_VALUES:
                continue
            if shape == () or (group == CURVE and len(shape) == 1 and shape[0]):
                figures.setdefault(key, np.ravel(artifact[name])[-1].item())
    except ArtifactError:
        return figures  # Its data is damaged, which `ifo verify` reports.
    return figures


Numbers = Mapping[str, float]
Part = Callable[[Numbers], str]


def _part(name: str, text: str, *others: str) -> Part:
    """Return a function that fills a figure into a text if it is known: the first known one of several names."""

    def say(numbers: Numbers) -> str:
        value = next((numbers[one] for one in (name, *others) if one in numbers), None)
        return "" if value is None else text.format(value)

    return say


def _demonstrations(numbers: Numbers) -> str:
    names = ("demos", "video_frames", "width", "height")
    if not all(name in numbers for name in names):
        return ""
    return "{:.0f} videos of {:.0f} frames, {:.0f}x{:.0f}".format(*(numbers[name] for name in names))


def _runs(numbers: Numbers) -> str:
    if "succeeded" in numbers and "runs" in numbers:
        return "{:.0f} of {:.0f} runs succeed".format(numbers["succeeded"], numbers["runs"])
    return _part("success_stochastic", "success {:.0%}", "success")(numbers)


_DISTANCE = "distance {:.3f}"
_RETURN = "return {:.2f}"
PARTS: dict[str, tuple[Part, ...]] = {
    "expert": (_part("success", "success {:.1%}"), _part("normalised_distance", _DISTANCE)),
    "demos": (_demonstrations,),
    "translator": (_part("psnr", "PSNR {:.1f} dB"), _part("feature_ratio", "feature ratio {:.2f}")),
    "translation": (
        _part("psnr", "PSNR {:.1f} dB"),
        _part("tau_returns", "tau {:.2f}"),
        _part("return_target", _RETURN),
    ),
    "policy": (
        _part("normalised_distance", _DISTANCE),
        _part("success", "success {:.0%}"),
        _part("env_return", _RETURN),
    ),
    "evaluation": (
        _runs,
        _part("normalised_distance_stochastic", _DISTANCE, "normalised_distance"),
        _part("env_return_stochastic", _RETURN, "env_return"),
    ),
}
