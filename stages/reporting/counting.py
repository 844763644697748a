"""Count every run once, and pool runs under one name only if they were made with the same settings."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from artifacts import stem_of
from stages.reporting.methods import ALWAYS, OF_REWARD, TRANSLATOR
from stages.reporting.rows import PolicyRun

R = TypeVar("R", bound=PolicyRun)
UNRECORDED = {"starts": 1}  # values of runs from before these were options


@dataclass(frozen=True)
class Duplicate:
    """A run that is left out because `kept` is the same run."""

    run: PolicyRun
    kept: PolicyRun


def count_once(runs: Sequence[R]) -> tuple[list[R], list[Duplicate]]:
    """Leave out duplicates: runs with the same policy, or with the same task, method and seeds.

    The newest evaluation of a run counts. Before that, runs of one method with different settings are distinguished:
    the most frequent settings keep the method's name, the others append what differs. Where it is not known which
    translator or demonstrations policies were made from, different policies append the names of their files.

    Returns:
        The runs that count, in their order, and those that do not.
    """
    named = _told_apart_by_file(_told_apart_by_settings(runs))
    counted: dict[Any, R] = {}
    kept, duplicates = set(), []
    newest_first = sorted(range(len(named)), key=lambda k: named[k].evaluation.manifest.created, reverse=True)
    for k in newest_first:
        run = named[k]
        keys = [run.identity, *([run.policy.digest] if run.policy else [])]
        same = next((counted[key] for key in keys if key in counted), None)
        if same is None:
            counted.update(dict.fromkeys(keys, run))
            kept.add(k)
        else:
            duplicates.append(Duplicate(run, same))
    return [run for k, run in enumerate(named) if k in kept], duplicates


def _told_apart_by_settings(runs: Sequence[R]) -> list[R]:
    groups: dict[tuple[str, str], list[str]] = {}
    for run in runs:
        groups.setdefault((run.task, run.method), []).append(json.dumps(_settings(run)))
    usual = {key: json.loads(Counter(group).most_common(1)[0][0]) for key, group in groups.items()}
    return [_named(run, usual[run.task, run.method]) for run in runs]


def _settings(run: PolicyRun) -> dict[str, Any]:
    """Recorded options by name, those of the translator with a prefix; options that are not recorded are left out."""
    options = {name: run.recorded.get(name) for name in (*ALWAYS, *OF_REWARD.get(run.recorded["reward"], ()))}
    options |= {name: value for name, value in UNRECORDED.items() if options[name] is None}
    options |= {f"translator {name}": run.translator.get(name) for name in TRANSLATOR}
    return {name: value for name, value in options.items() if value is not None}


def _named(run: R, usual: dict[str, Any]) -> R:
    # An option that only one of the two records does not distinguish them.
    differing = {name: value for name, value in _settings(run).items() if name in usual and value != usual[name]}
    return replace(
        run, method=", ".join([run.method, *(f"{name} {_text(value)}" for name, value in differing.items())])
    )


def _text(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else json.dumps(value)


def _told_apart_by_file(runs: Sequence[R]) -> list[R]:
    uncertain: dict[Any, list[R]] = {}
    for run in runs:
        if run.unknown:
            uncertain.setdefault(run.identity, []).append(run)
    ambiguous = {
        run.evaluation.path
        for group in uncertain.values()
        if len({run.policy and run.policy.digest for run in group}) > 1
        for run in group
    }
    return [
        replace(run, method=f"{run.method} ({stem_of(run.evaluation.path)})")
        if run.evaluation.path in ambiguous and run.unknown
        else run
        for run in runs
    ]
