"""The kinds of artifact: the datasets that each must hold, and what later stages read of its configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from artifacts.configurations import Configuration, LearnedConfiguration, TranslatorConfiguration
from artifacts.errors import ArtifactError
from artifacts.schema import first_problem

DIGESTS_SINCE = 2  # first schema version with a digest of each dataset and of the content
SCHEMA = 2  # current schema version of every kind


def is_finite(array: np.ndarray) -> bool:
    """Return whether no value is NaN or infinite; arrays without numbers are finite."""
    return array.dtype.kind not in "fc" or bool(np.isfinite(array).all())


@dataclass(frozen=True)
class DatasetSpec:
    """Axes and types of a dataset.

    Attributes:
      axes: A name or a fixed length per axis; the same name means the same length throughout the file. None: any shape.
      dtypes: Exact names ("uint8") or NumPy kinds ("f"). Empty: any.
      least: Minimum length of every axis.
      finite: Whether no value may be NaN or infinite.
    """

    axes: tuple[str | int, ...] | None = None
    dtypes: tuple[str, ...] = ()
    least: int = 0
    finite: bool = False

    @property
    def ndim(self) -> int | None:
        return None if self.axes is None else len(self.axes)

    def problem(self, shape: tuple[int, ...], dtype: np.dtype, lengths: dict[str, int]) -> str | None:
        """Describe why an array does not fit, or return None; `lengths` collects the lengths of the named axes."""
        if self.dtypes and dtype.name not in self.dtypes and dtype.kind not in self.dtypes:
            return f"is {dtype.name}, expected {self}"
        if self.axes is None:
            return None
        if len(shape) != len(self.axes):
            return f"has shape {shape}, expected {self}"
        if any(length < self.least for length in shape):
            return f"has shape {shape}, expected {self} without empty axes"
        for axis, length in zip(self.axes, shape, strict=True):
            wanted = axis if isinstance(axis, int) else lengths.setdefault(axis, length)
            if length != wanted:
                return f"has shape {shape}, expected {self} with {axis} = {wanted}"
        return None

    def __str__(self) -> str:
        names = {"f": "float", "uint8": "uint8"}
        dtypes = " or ".join(names.get(dtype, dtype) for dtype in self.dtypes) or "any type"
        return dtypes if self.axes is None else f"{dtypes} ({', '.join(map(str, self.axes))})"


@dataclass(frozen=True)
class KindSpec:
    """The datasets that a kind of artifact must hold; it may hold more.

    Attributes:
      version: The schema version that is written, and the newest that can be read.
      datasets: Required datasets; a name ending in `/*` means at least one dataset in that group.
      optional: Datasets that may be missing.
      config: What later stages read of the configuration.
    """

    version: int = SCHEMA
    datasets: Mapping[str, DatasetSpec] = field(default_factory=dict)
    optional: Mapping[str, DatasetSpec] = field(default_factory=dict)
    config: type[Configuration] = Configuration

    def check_config(self, values: Mapping[str, Any]) -> None:
        """Raise ArtifactError, without the file's name, if a value has another type than later stages expect."""
        try:
            self.config.model_validate(dict(values))
        except ValidationError as error:
            raise ArtifactError(f"bad configuration: {first_problem(error)}: make the file again") from error

    def must_be_finite(self, name: str) -> bool:
        """Return whether a dataset may hold neither NaN nor infinity."""
        specs = {**self.datasets, **self.optional}
        spec = specs.get(name) or specs.get(f"{name.partition('/')[0]}/*")
        return spec is not None and spec.finite

    def problem(self, found: Mapping[str, tuple[tuple[int, ...], np.dtype]]) -> str | None:
        """Describe the first missing or mismatching dataset among name -> (shape, dtype), or return None."""
        lengths: dict[str, int] = {}
        for wanted, spec in {**self.datasets, **self.optional}.items():
            if wanted.endswith("/*"):
                names = [name for name in found if name.startswith(wanted[:-1])]
            else:
                names = [wanted] if wanted in found else []
            if not names and wanted in self.datasets:
                return f"dataset {wanted} is missing, expected {spec}"
            for name in names:
                problem = spec.problem(*found[name], lengths)
                if problem:
                    return f"dataset {name} {problem}"
        return None


_WEIGHTS = {"weights/*": DatasetSpec(None, ("f", "i", "u", "b"), finite=True)}
# Metrics and learning curves may be undefined, and distances of a simulation that diverged infinite.
_METRIC, _CURVE = DatasetSpec((), ("f",)), DatasetSpec(("I",), ("f",))
_CONTEXT = DatasetSpec(finite=True)
_SCALE = DatasetSpec((), ("f",), finite=True)
_OUTCOME = DatasetSpec(("R", "E"), ("f",), least=1)

KINDS: dict[str, KindSpec] = {
    "expert": KindSpec(SCHEMA, _WEIGHTS, config=LearnedConfiguration),
    "demos": KindSpec(
        SCHEMA,
        {"frames": DatasetSpec(("N", "T", "H", "W", 3), ("uint8",), least=1)},
        # Simulated demonstrations have distances; imported ones have the time stamps of their frames.
        {
            **dict.fromkeys(("final_distance", "env_return", "success"), DatasetSpec(("N",), ("f",))),
            "times": DatasetSpec(("N", "T"), ("f",), finite=True),
        },
    ),
    "translator": KindSpec(
        SCHEMA, _WEIGHTS, {"metrics/*": _METRIC, "curve/seconds": _CURVE}, config=TranslatorConfiguration
    ),
    "translation": KindSpec(
        SCHEMA,
        {
            "context_frame": DatasetSpec(("H", "W", 3), ("uint8",), least=1),
            "target_features": DatasetSpec(("T", "D"), ("f",), least=1, finite=True),
            "target_images": DatasetSpec(("T", "H", "W", 3), ("uint8", "f"), least=1, finite=True),
        },
        {
            "feature_scale": _SCALE,
            "image_scale": _SCALE,
            "features": DatasetSpec(("N", "T", "D"), ("f",), finite=True),
            "images": DatasetSpec(("N", "T", "H", "W", 3), ("uint8",)),
            "expert_features": DatasetSpec(("T", "D"), ("f",), finite=True),
            "expert_frames": DatasetSpec(("T", "H", "W", 3), ("uint8",)),
            "contexts/*": _CONTEXT,
            "metrics/*": _METRIC,
        },
    ),
    "policy": KindSpec(
        SCHEMA,
        _WEIGHTS,
        {
            "contexts/*": _CONTEXT,
            **dict.fromkeys(
                ("curve/samples", "curve/seconds", "curve/normalised_distance", "curve/env_return", "curve/success"),
                replace(_CURVE, least=1),
            ),
        },
        LearnedConfiguration,
    ),
    "evaluation": KindSpec(
        SCHEMA,
        {},
        {
            # Of a simulated task.
            **dict.fromkeys(("initial_distance", "final_distance", "normalised_distance"), _OUTCOME),
            **dict.fromkeys(("final_distance_stochastic", "normalised_distance_stochastic"), _OUTCOME),
            # Of a Gymnasium environment; success only if it reports it.
            **dict.fromkeys(("env_return", "env_return_stochastic", "success", "success_stochastic"), _OUTCOME),
            **dict.fromkeys(
                ("curve/samples", "curve/normalised_distance", "curve/env_return", "curve/success"),
                DatasetSpec(("R", "I"), ("f",)),
            ),
        },
    ),
    "checkpoint": KindSpec(SCHEMA, optional={"tree": DatasetSpec(("L",), ("uint8",))}),
}
