"""Statistics over the runs of a task and method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.config.stages import TASKS
from stages.reporting.intervals import bootstrap_mean, wilson
from stages.reporting.paper import SUCCESS
from stages.reporting.rows import Run

FIRST = ("oracle", "translation")  # methods that tables and plots show first; ablations follow


@dataclass(frozen=True)
class Summary:
    """Figures over the runs of one task and method.

    Attributes:
        succeeded: Number of runs that succeed by the paper's criterion.
        success_interval: 95% Wilson interval of the success rate.
        deterministic: Success rate of the deterministic policies' episodes.
        distance, distance_interval: Mean normalized final distance and its bootstrap interval over runs.
        samples, learning_minutes: Means over runs.
        translator_minutes: Mean over the runs where it is known; None if it is known of none.
        paper: Success rate in the paper; None if it reports none.
    """

    task: str
    method: str
    runs: tuple[Run, ...]
    succeeded: int
    success_interval: tuple[float, float]
    deterministic: float
    distance: float
    distance_interval: tuple[float, float]
    samples: float
    learning_minutes: float
    translator_minutes: float | None
    paper: float | None

    @property
    def success(self) -> float:
        return self.succeeded / len(self.runs)

    @property
    def label(self) -> str:
        """The method, and how many of its runs succeed."""
        return f"{self.method} ({self.succeeded} of {len(self.runs)})"

    @property
    def curve_label(self) -> str:
        """What the learning curves show."""
        return "final distance / initial distance"

    @property
    def threshold(self) -> float | None:
        """Value of the learning curve below which a run succeeds; None: there is none."""
        return self.runs[0].threshold


def summarise(runs: Sequence[Run]) -> list[Summary]:
    """Group runs by task and method, in the order in which tables and plots show them."""
    groups: dict[tuple[str, str], list[Run]] = {}
    for run in runs:
        groups.setdefault((run.task, run.method), []).append(run)
    return [_summary(task, method, groups[task, method]) for task, method in sorted(groups, key=_order)]


def _order(key: tuple[str, str]) -> tuple[object, ...]:
    task, method = key
    known = TASKS.index(task) if task in TASKS else len(TASKS)
    rank = FIRST.index(method) if method in FIRST else len(FIRST) + (not method.startswith("translation"))
    return known, task, rank, method


def _summary(task: str, method: str, runs: list[Run]) -> Summary:
    distances = np.array([run.normalised_distance for run in runs])
    minutes = [run.translator_minutes for run in runs if run.translator_minutes is not None]
    succeeded = sum(run.success for run in runs)
    return Summary(
        task=task,
        method=method,
        runs=tuple(runs),
        succeeded=succeeded,
        success_interval=wilson(succeeded, len(runs)),
        deterministic=float(np.mean([run.deterministic_success for run in runs])),
        distance=float(distances.mean()),
        distance_interval=bootstrap_mean(distances),
        samples=float(np.mean([run.recorded["samples"] for run in runs])),
        learning_minutes=float(np.mean([run.recorded["learning_minutes"] for run in runs])),
        translator_minutes=float(np.mean(minutes)) if minutes else None,
        paper=SUCCESS.get((task, method)),
    )
