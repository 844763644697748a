"""The origin of every number: the files, commands and seeds behind each run."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from artifacts import Ancestor, Artifact, ancestors, sha256_of
from stages.reporting.counting import Duplicate
from stages.reporting.rows import METRICS, PolicyRun

# Shown elsewhere in a run's section.
SAID = ("policy", "method", "translation_metrics", "samples", "learning_minutes")
STATES = {
    "missing": "missing; recorded when it was used:",
    "unreadable": "cannot be read; recorded when it was used:",
    "changed": "replaced by another file; recorded when it was used:",
}


@dataclass(frozen=True)
class AncestorEntry:
    """A file that a run was made from; `gone` says what has become of it, and is empty if it is there."""

    kind: str
    path: str
    gone: str
    facts: dict[str, str]


@dataclass(frozen=True)
class RunEntry:
    """A run: a line on how it ended, what is known of it, and the files behind it; no files: none are recorded."""

    heading: str
    facts: dict[str, str]
    chain: list[AncestorEntry]


@dataclass(frozen=True)
class Lineage:
    """A section of the page on one evaluation. The texts are not escaped.

    Attributes:
        anchor: Its id on the page.
        file: Name of the evaluation's file.
        about: Task, methods, number of runs.
        facts: What is known of the file.
        runs: Its runs that count.
        notes: One line for each run that counts elsewhere.
    """

    anchor: str
    file: str
    about: str
    facts: dict[str, str]
    runs: list[RunEntry]
    notes: list[str]


def lineage(artifact: Artifact, anchor: str, runs: Sequence[PolicyRun], duplicates: Sequence[Duplicate]) -> Lineage:
    """What is known of an evaluation, and of each of its runs down to command and seed.

    Args:
        artifact: The evaluation.
        anchor: Id of the section.
        runs: Its runs that count.
        duplicates: Its runs that count elsewhere.
    """
    whole = [*runs, *(item.run for item in duplicates)]
    methods = ", ".join(dict.fromkeys(run.method for run in whole))
    environment = ", ".join(f"{key} {value}" for key, value in artifact.manifest.environment.items() if value)
    return Lineage(
        anchor,
        artifact.path.name,
        f"{whole[0].task}: {methods}: {len(whole)} run{'s' * (len(whole) != 1)}",
        {
            "file": str(artifact.path),
            "sha256": sha256_of(artifact.path),
            **origin_of(artifact),
            "environment": environment,
        },
        [_run_entry(run) for run in runs],
        [f"{item.run.name} counts once, as a run of {item.kept.evaluation.path}." for item in duplicates],
    )


def _run_entry(run: PolicyRun) -> RunEntry:
    heading = f"{run.name}: {run.method}, context {run.seed_of_context}, seed {run.recorded['seed']}: {run.verdict}"
    chain = [] if run.policy is None else list(ancestors(run.evaluation, [run.policy], check=True))
    return RunEntry(heading, _figures(run), [ancestor_entry(item) for item in chain])


def _figures(run: PolicyRun) -> dict[str, str]:
    """Results and settings of a run, as texts."""
    recorded = {name: value for name, value in run.recorded.items() if name not in SAID}
    return {
        **run.figures(),
        "samples": f"{run.recorded['samples']:,}",
        "learning minutes": f"{run.recorded['learning_minutes']:.2f}",
        **{f"translation: {name}": f"{run.metrics[name]:.3f}" for name in METRICS if name in run.metrics},
        "recorded settings": ", ".join(f"{name} {_value(value)}" for name, value in recorded.items()),
    }


def ancestor_entry(item: Ancestor) -> AncestorEntry:
    """What is known of a file that an artifact was made from."""
    facts = {"digest": item.parent.digest}
    if item.artifact is None:
        return AncestorEntry(item.parent.kind, str(item.path), STATES[item.state], facts)
    return AncestorEntry(item.parent.kind, str(item.path), "", {**facts, **origin_of(item.artifact)})


def origin_of(artifact: Artifact) -> dict[str, str]:
    """Command, seed, time and version with which a file was made."""
    manifest = artifact.manifest
    return {
        "command": manifest.command,
        "seed": str(manifest.seed),
        "created": manifest.created,
        "ifo version": manifest.ifo_version,
    }


def _value(value: Any) -> str:
    if value is None or value == {}:
        return "unknown"
    return value if isinstance(value, str) and value else json.dumps(value)
