"""Learning runs as rows of a table, read from evaluation artifacts."""

from __future__ import annotations

import csv
import io
from abc import ABC, abstractmethod
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
class PolicyRun(ABC):
    """One policy with the results of its evaluation.

    Attributes:
        evaluation: The artifact that contains the run at position `index`.
        policy: The policy's file as the evaluation recorded it; None if it did not.
        recorded: The evaluation's record of the run: reward, options, seeds.
        task: Name of the task or environment.
        samples_curve: Samples (I,) at which the learning curve was measured; empty if the evaluation has none.
    """

    evaluation: Artifact
    index: int
    policy: Parent | None
    recorded: dict[str, Any]
    task: str
    method: str
    samples_curve: np.ndarray

    @property
    @abstractmethod
    def verdict(self) -> str:
        """How the run ended, in a few words."""

    @abstractmethod
    def figures(self) -> dict[str, str]:
        """Results of the evaluation, as texts."""

    @property
    def seed_of_context(self) -> int:
        """Seed of the learner's context."""
        return int(self.recorded["context_seed"])

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
        return self.task, self.method, self.seed_of_context, self.recorded["seed"]

    @property
    def unknown(self) -> str:
        """Which of the files that decide the method is not known: `translator`, `demonstrations`, or none ('')."""
        return unknown_part(self.recorded)

    @property
    def tracks(self) -> bool:
        """Whether the reward is computed with the translator."""
        return self.recorded.get("reward") in TRACKED


@dataclass(frozen=True)
class Run(PolicyRun):
    """A policy in a simulated task, judged by its distance to the goal.

    Attributes:
        threshold: Normalized final distance below which a run succeeds.
        initial_distance, final_distance, normalised_distance: Means over episodes of the stochastic policy.
        deterministic_distance: Mean normalized final distance of the deterministic policy.
        deterministic_success: Fraction of its episodes that end below the threshold.
        distance_curve: Learning curve (I,), normalized; empty if the evaluation has none.
    """

    threshold: float
    initial_distance: float
    final_distance: float
    normalised_distance: float
    deterministic_distance: float
    deterministic_success: float
    distance_curve: np.ndarray

    @property
    def curve(self) -> np.ndarray:
        return self.distance_curve

    @property
    def success(self) -> bool:
        """By the paper's criterion, which judges the mean over the stochastic policy's episodes."""
        return self.normalised_distance < self.threshold

    @property
    def verdict(self) -> str:
        return f"{self.normalised_distance:.3f} of the initial distance, {'succeeds' if self.success else 'fails'}"

    def figures(self) -> dict[str, str]:
        return {
            "success, paper's criterion": f"{'yes' if self.success else 'no'} (below {self.threshold:g})",
            "normalized final distance, stochastic policy": f"{self.normalised_distance:.4f}",
            "normalized final distance, deterministic policy": f"{self.deterministic_distance:.4f}",
            "success rate of deterministic episodes": f"{self.deterministic_success:.3f}",
            "initial and final distance": f"{self.initial_distance:.4f}, {self.final_distance:.4f}",
        }


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
    curves = [curve_of(artifact, "normalised_distance", index) for index in range(len(described))]
    policies = policies_of(artifact, len(described))
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


def policies_of(artifact: Artifact, runs: int) -> list[Parent | None]:
    """The recorded file of each of the evaluation's policies; None of each if they are not all recorded."""
    found: list[Parent | None] = [parent for parent in artifact.manifest.parents if parent.kind == "policy"]
    return found if len(found) == runs else [None] * runs


def _threshold(artifact: Artifact) -> float:
    recorded = artifact.config.get("success_threshold")
    if recorded is not None:
        return float(recorded)
    # Older evaluations do not record it.
    from stages.simulation.gl import choose_backend
    from stages.simulation.registry import make_task

    choose_backend(required=False)
    return float(make_task(artifact.config["task"]).success_threshold)


def curve_of(artifact: Artifact, name: str, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Samples and learning curve (I,) of a run without the NaN padding; both are empty in older evaluations."""
    if "curve/samples" not in artifact or f"curve/{name}" not in artifact:
        return np.empty(0), np.empty(0)
    samples, values = artifact["curve/samples"][index], artifact[f"curve/{name}"][index]
    known = np.isfinite(samples) & np.isfinite(values)
    return samples[known], values[known]


def row(run: Run) -> dict[str, object]:
    """A run as a row of `COLUMNS`; unknown values are left out."""
    return {
        "task": run.task,
        "method": run.method,
        "context_seed": run.seed_of_context,
        "initial_distance": round(run.initial_distance, 4),
        "final_distance": round(run.final_distance, 4),
        "normalised_distance": round(run.normalised_distance, 4),
        "success_paper": int(run.success),
        "normalised_distance_deterministic": round(run.deterministic_distance, 4),
        "success_deterministic": round(run.deterministic_success, 3),
        **costs(run),
    }


def costs(run: PolicyRun) -> dict[str, object]:
    """Samples, minutes and metrics of a run, for its row in a table."""
    minutes = run.translator_minutes
    return {
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
