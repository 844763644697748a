"""Learning runs in Gymnasium environments: rows and statistics of success rates and of the environments' returns."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from artifacts import Artifact, ArtifactError
from stages.reporting.intervals import bootstrap_mean
from stages.reporting.names import method_name
from stages.reporting.records import checked_records
from stages.reporting.rows import METRICS, PolicyRun, costs, csv_text, curve_of, policies_of

COLUMNS = (
    "environment",
    "method",
    "env_seed",
    "seed",
    "success",
    "success_deterministic",
    "env_return",
    "env_return_deterministic",
    "episodes",
    "samples",
    "translator_minutes",
    "learning_minutes",
    *METRICS,
)


@dataclass(frozen=True)
class Curve:
    """A learning curve (I,) over the samples (I,) at which it was measured."""

    samples_curve: np.ndarray
    curve: np.ndarray


@dataclass(frozen=True)
class EnvironmentRun(PolicyRun):
    """A policy in a Gymnasium environment.

    Attributes:
        success, success_deterministic: Success rates of the stochastic and the deterministic policy's episodes; None:
            the environment does not report success.
        env_return, env_return_deterministic: Mean returns of the environment's own reward.
        success_curve, return_curve: Learning curves, of which each has its own `samples_curve` (I,); empty if the
            evaluation has none.
    """

    success: float | None
    success_deterministic: float | None
    env_return: float
    env_return_deterministic: float
    success_curve: Curve
    return_curve: Curve

    @property
    def seed_of_context(self) -> int:
        return int(self.recorded["environment"]["seed"])

    @property
    def identity(self) -> tuple[Any, ...]:
        # The learner's context is a seed and a viewpoint.
        place = json.dumps(self.recorded["environment"], sort_keys=True)
        return self.task, self.method, place, self.recorded["seed"]

    @property
    def verdict(self) -> str:
        succeeded = "" if self.success is None else f"{self.success:.0%} of the episodes succeed, "
        return f"{succeeded}return {self.env_return:.2f}"

    def figures(self) -> dict[str, str]:
        rates = {"stochastic policy": self.success, "deterministic policy": self.success_deterministic}
        return {f"success rate, {who}": f"{rate:.3f}" for who, rate in rates.items() if rate is not None} | {
            "return of the environment's own reward, stochastic policy": f"{self.env_return:.4g}",
            "return of the environment's own reward, deterministic policy": f"{self.env_return_deterministic:.4g}",
        }


@dataclass(frozen=True)
class EnvironmentSummary:
    """Means over the runs of one environment and method, with 95% bootstrap intervals over runs.

    Attributes:
        success, success_interval, deterministic: Success rates of the stochastic policies' episodes, and of the
            deterministic ones'; None: a run has none.
        env_return, return_interval: Return of the environment's own reward.
        samples, learning_minutes, translator_minutes: See `Summary`.
    """

    task: str
    method: str
    runs: tuple[EnvironmentRun, ...]
    success: float | None
    success_interval: tuple[float, float] | None
    deterministic: float | None
    env_return: float
    return_interval: tuple[float, float]
    samples: float
    learning_minutes: float
    translator_minutes: float | None
    paper: None = None

    @property
    def label(self) -> str:
        """The method, and the number of its runs."""
        return f"{self.method} ({len(self.runs)})"


def read_environment_runs(artifact: Artifact) -> list[EnvironmentRun]:
    """The runs of an evaluation in a Gymnasium environment.

    Raises:
        ArtifactError: It is damaged, or its records of the runs are incomplete.
    """
    described = checked_records(artifact)
    outcomes = {name: artifact[name] for name in ("env_return", "env_return_stochastic")}
    outcomes |= {name: artifact[name] for name in ("success", "success_stochastic") if name in artifact}
    if any(len(values) != len(described) for values in outcomes.values()):
        raise ArtifactError(f"{artifact.path}: describes {len(described)} runs and holds others: make it again")
    policies = policies_of(artifact, len(described))

    def mean(name: str, k: int) -> float | None:
        return float(outcomes[name][k].mean()) if name in outcomes else None

    runs = []
    for k, recorded in enumerate(described):
        returns = Curve(*curve_of(artifact, "env_return", k))
        runs.append(
            EnvironmentRun(
                evaluation=artifact,
                index=k,
                policy=policies[k],
                recorded=recorded,
                task=name_of(recorded["environment"]),
                method=method_name(recorded),
                samples_curve=returns.samples_curve,
                success=mean("success_stochastic", k),
                success_deterministic=mean("success", k),
                env_return=float(outcomes["env_return_stochastic"][k].mean()),
                env_return_deterministic=float(outcomes["env_return"][k].mean()),
                success_curve=Curve(*curve_of(artifact, "success", k)),
                return_curve=returns,
            )
        )
    return runs


def name_of(environment: Mapping[str, Any]) -> str:
    """What runs must share to be compared: an environment's name, arguments, steps per episode and judge of success."""
    words = [environment["name"], *(f"{key}={value}" for key, value in environment["kwargs"].items())]
    judge = f", success {environment['success']}" if environment.get("success") else ""
    return f"{' '.join(words)} ({environment['control_steps']} steps{judge})"


def summarise_environments(runs: Sequence[EnvironmentRun]) -> list[EnvironmentSummary]:
    """Group runs by environment and method, both in the order of their names, the method itself first."""
    groups: dict[tuple[str, str], list[EnvironmentRun]] = {}
    for run in runs:
        groups.setdefault((run.task, run.method), []).append(run)
    ordered = sorted(groups, key=lambda key: (key[0], not key[1].startswith("translation"), key[1]))
    return [_summary(*key, groups[key]) for key in ordered]


def _summary(task: str, method: str, runs: list[EnvironmentRun]) -> EnvironmentSummary:
    rates = [run.success for run in runs if run.success is not None]
    calm = [run.success_deterministic for run in runs if run.success_deterministic is not None]
    known = len(rates) == len(calm) == len(runs)
    returns = np.array([run.env_return for run in runs])
    minutes = [run.translator_minutes for run in runs if run.translator_minutes is not None]
    return EnvironmentSummary(
        task=task,
        method=method,
        runs=tuple(runs),
        success=float(np.mean(rates)) if known else None,
        success_interval=bootstrap_mean(np.array(rates)) if known else None,
        deterministic=float(np.mean(calm)) if known else None,
        env_return=float(returns.mean()),
        return_interval=bootstrap_mean(returns),
        samples=float(np.mean([run.recorded["samples"] for run in runs])),
        learning_minutes=float(np.mean([run.recorded["learning_minutes"] for run in runs])),
        translator_minutes=float(np.mean(minutes)) if minutes else None,
    )


def environment_row(run: EnvironmentRun) -> dict[str, object]:
    """A run as a row of `COLUMNS`; unknown values are left out."""
    return {
        "environment": run.task,
        "method": run.method,
        "env_seed": run.seed_of_context,
        "seed": run.recorded["seed"],
        "success": "" if run.success is None else round(run.success, 3),
        "success_deterministic": "" if run.success_deterministic is None else round(run.success_deterministic, 3),
        "env_return": float(f"{run.env_return:.5g}"),
        "env_return_deterministic": float(f"{run.env_return_deterministic:.5g}"),
        "episodes": run.recorded["samples"] // max(run.recorded["environment"]["control_steps"], 1),
        **costs(run),
    }


def environments_as_csv(runs: Sequence[EnvironmentRun]) -> str:
    """One row per run, under `COLUMNS`."""
    return csv_text(COLUMNS, map(environment_row, runs))
