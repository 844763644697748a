"""Learning runs as rows of a table, read from evaluation artifacts."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from artifacts import Artifact, ArtifactError, Parent
from stages.reporting.names import TRACKED, method_name, unknown_part
from stages.reporting.records import checked_records
from stages.runtime.terminal import one_line

# Metrics that `ifo translate` computes before learning.
METRICS = (
    "psnr",
    "copy_psnr",
    "image_ratio",
    "feature_ratio",
    "tau_expert",
    "tau_noisy",
    "tau_random",
    "tau_returns",
    "tau_way",
)
# Columns of a table with one row per run.
COLUMNS = (
    "task",
    "method",
    "context_seed",
    "initial_distance",
    "final_distance",
    "normalised_distance",
    "success_paper",
    "normalised_distance_deterministic",
    "success_deterministic",
    "samples",
    "translator_minutes",
    "learning_minutes",
    *METRICS,
)
FORMULA = tuple("=+-@\uff1d\uff0b\uff0d\uff20")  # how a formula of a spreadsheet starts, also full-width


@dataclass(frozen=True)
class Run:
    """One policy with the results of its evaluation.

    Attributes:
        evaluation: The artifact that contains the run at position `index`.
        policy: The policy's file as the evaluation recorded it; None if it did not.
        recorded: The evaluation's record of the run: reward, options, seeds.
        threshold: Normalized final distance below which a run succeeds.
        initial_distance, final_distance, normalised_distance: Means over episodes of the stochastic policy.
        deterministic_distance: Mean normalized final distance of the deterministic policy.
        deterministic_success: Fraction of its episodes that end below the threshold.
        samples_curve, distance_curve: Learning curve (I,), normalized; empty if the evaluation has none.
    """

    evaluation: Artifact
    index: int
    policy: Parent | None
    recorded: dict[str, Any]
    task: str
    method: str
    threshold: float
    initial_distance: float
    final_distance: float
    normalised_distance: float
    deterministic_distance: float
    deterministic_success: float
    samples_curve: np.ndarray
    distance_curve: np.ndarray

    @property
    def success(self) -> bool:
        """By the paper's criterion, which judges the mean over the stochastic policy's episodes."""
        return self.normalised_distance < self.threshold

    @property
    def name(self) -> str:
        return str(self.recorded.get("policy") or f"run {self.index + 1}")

    @property
    def translator_minutes(self) -> float | None:
        """Minutes that training the translator took; None where the reward needs none, or it is not known."""
        minutes = self.translator.get("minutes")
        return None if minutes is None else float(minutes)

    @property
    def translator(self) -> dict[str, Any]:
        """What is recorded of the translator, if the reward needs it; {} if not, or if it is not known."""
        return (self.recorded.get("translator") or {}) if self.tracks else {}

    @property
    def metrics(self) -> dict[str, float]:
        """The known ones of `METRICS`, for the reward that they judge."""
        judged = self.recorded.get("reward") == "translation"
        found = (self.recorded.get("translation_metrics") or {}) if judged else {}
        return {name: float(found[name]) for name in METRICS if found.get(name) is not None}

    @property
    def identity(self) -> tuple[Any, ...]:
        """Equal for two evaluations of the same run."""
        return self.task, self.method, self.recorded["context_seed"], self.recorded["seed"]

    @property
    def unknown(self) -> str:
        """Which of the files that decide the method is not known: `translator`, `demonstrations`, or none ('')."""
        return unknown_part(self.recorded)

    @property
    def tracks(self) -> bool:
        """Whether the reward is computed with the translator."""
        return self.recorded.get("reward") in TRACKED


def read_runs(artifact: Artifact) -> list[Run]:
    """The runs of an evaluation artifact.

    Raises:
        ArtifactError: It is damaged, or its records of the runs are incomplete.
    """
    described = checked_records(artifact)
    names = ("initial_distance", "final_distance_stochastic", "normalised_distance_stochastic", "normalised_distance")
    initial, final, noisy, calm = (artifact[name] for name in names)
    if not len(described) == len(initial) == len(final) == len(noisy) == len(calm):
        raise ArtifactError(f"{artifact.path}: describes {len(described)} runs and holds {len(noisy)}: make it again")
    threshold = _threshold(artifact)
    curves = [_curve(artifact, index) for index in range(len(described))]
    policies: list[Parent | None] = [parent for parent in artifact.manifest.parents if parent.kind == "policy"]
    if len(policies) != len(described):
        policies = [None] * len(described)
    return [
        Run(
            evaluation=artifact,
            index=k,
            policy=policies[k],
            recorded=run,
            task=str(artifact.config["task"]),
            method=method_name(run),
            threshold=threshold,
            initial_distance=float(initial[k].mean()),
            final_distance=float(final[k].mean()),
            normalised_distance=float(noisy[k].mean()),
            deterministic_distance=float(calm[k].mean()),
            deterministic_success=float((calm[k] < threshold).mean()),
            samples_curve=curves[k][0],
            distance_curve=curves[k][1],
        )
        for k, run in enumerate(described)
    ]


def of_environment(artifact: Artifact) -> bool:
    """Whether an evaluation is of policies in a Gymnasium environment, which have no distance to a goal."""
    return "env_return" in artifact


def _threshold(artifact: Artifact) -> float:
    recorded = artifact.config.get("success_threshold")
    if recorded is not None:
        return float(recorded)
    # Older evaluations do not record it.
    from stages.simulation.gl import choose_backend
    from stages.simulation.registry import make_task

    choose_backend(required=False)
    return float(make_task(artifact.config["task"]).success_threshold)


def _curve(artifact: Artifact, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Samples and normalized distances (I,) without the NaN padding; empty in older evaluations."""
    if "curve/samples" not in artifact or "curve/normalised_distance" not in artifact:
        return np.empty(0), np.empty(0)
    samples, distances = artifact["curve/samples"][index], artifact["curve/normalised_distance"][index]
    known = np.isfinite(samples) & np.isfinite(distances)
    return samples[known], distances[known]


def row(run: Run) -> dict[str, object]:
    """A run as a row of `COLUMNS`; unknown values are left out."""
    minutes = run.translator_minutes
    return {
        "task": run.task,
        "method": run.method,
        "context_seed": run.recorded["context_seed"],
        "initial_distance": round(run.initial_distance, 4),
        "final_distance": round(run.final_distance, 4),
        "normalised_distance": round(run.normalised_distance, 4),
        "success_paper": int(run.success),
        "normalised_distance_deterministic": round(run.deterministic_distance, 4),
        "success_deterministic": round(run.deterministic_success, 3),
        "samples": run.recorded["samples"],
        "translator_minutes": "" if minutes is None else round(minutes, 1),
        "learning_minutes": round(run.recorded["learning_minutes"], 2),
        **{name: round(value, 3) for name, value in run.metrics.items()},
    }


def as_csv(runs: Sequence[Run]) -> str:
    """One row per run, under `COLUMNS`."""
    return csv_text(COLUMNS, map(row, runs))


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """A table as CSV; no text in it is a formula to a spreadsheet."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, columns)
    writer.writeheader()
    writer.writerows({name: _harmless(value) for name, value in each.items()} for each in rows)
    return text.getvalue()


def _harmless(value: object) -> object:
    """A cell's value; a text is one line, and one that a spreadsheet would compute gets an apostrophe in front."""
    if not isinstance(value, str):
        return value
    return one_line(f"'{value}" if value.lstrip().startswith(FORMULA) else value)
