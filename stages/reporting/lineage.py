"""Where every number comes from: the files, commands and seeds behind each run."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from typing import Any

from artifacts import Ancestor, Artifact, ancestors, sha256_of
from stages.reporting.counting import Duplicate
from stages.reporting.rows import METRICS, Run

# What a run's own line or its figures say already.
SAID = ("policy", "method", "translation_metrics", "samples", "learning_minutes")
STATES = {
    "missing": "gone; this is what was recorded of it when it was used",
    "unreadable": "there, but cannot be read",
    "changed": "gone: another file has taken its place; this is what was recorded of it when it was used",
}


def lineage(artifact: Artifact, name: str, runs: Sequence[Run], duplicates: Sequence[Duplicate]) -> str:
    """A collapsible section on an evaluation: itself, and each of its runs down to command and seed.

    Args:
        artifact: The evaluation.
        name: Anchor of the section.
        runs: Its runs that count.
        duplicates: Its runs that count elsewhere.
    """
    whole = [*runs, *(item.run for item in duplicates)]
    methods = ", ".join(dict.fromkeys(run.method for run in whole))
    about = f"{artifact.config['task']}: {methods}: {len(whole)} run{'s' * (len(whole) != 1)}"
    heading = f"<b>{escape(artifact.path.name)}</b>: {escape(about)}"
    environment = ", ".join(f"{key} {value}" for key, value in artifact.manifest.environment.items() if value)
    itself = {
        "file": str(artifact.path),
        "sha256": sha256_of(artifact.path),
        **_origin(artifact),
        "environment": environment,
    }
    parts = [f'<details id="{escape(name)}"><summary>{heading}</summary>', _facts(itself)]
    parts += [_run_section(run) for run in runs]
    parts += [
        f"<p>{escape(item.run.name)} counts once, as a run of {escape(str(item.kept.evaluation.path))}.</p>"
        for item in duplicates
    ]
    return "\n".join([*parts, "</details>"])


def _run_section(run: Run) -> str:
    verdict = "succeeds" if run.success else "fails"
    heading = (
        f"{escape(run.name)}: {escape(run.method)}, context {run.recorded['context_seed']}, "
        f"seed {run.recorded['seed']}: {run.normalised_distance:.3f} of the distance left, {verdict}"
    )
    chain = [] if run.policy is None else list(ancestors(run.evaluation, [run.policy], check=True))
    made_from = "".join(_ancestor(item) for item in chain) or "<p>The evaluation records no policy file.</p>"
    return "\n".join(
        [
            f"<details><summary>{heading}</summary>",
            _facts(_figures(run)),
            "<h4>Made from</h4>",
            f'<ol class="chain">{made_from}</ol>' if chain else made_from,
            "</details>",
        ]
    )


def _figures(run: Run) -> dict[str, str]:
    """What is known of a run, as texts."""
    recorded = {name: value for name, value in run.recorded.items() if name not in SAID}
    return {
        "success, paper's criterion": f"{'yes' if run.success else 'no'} (below {run.threshold:g})",
        "distance left, stochastic policy": f"{run.normalised_distance:.4f}",
        "distance left, deterministic policy": f"{run.deterministic_distance:.4f}",
        "deterministic episodes that succeed": f"{run.deterministic_success:.3f}",
        "initial and final distance": f"{run.initial_distance:.4f}, {run.final_distance:.4f}",
        "samples": f"{run.recorded['samples']:,}",
        "learning, minutes": f"{run.recorded['learning_minutes']:.2f}",
        **{f"translation: {name}": f"{run.metrics[name]:.3f}" for name in METRICS if name in run.metrics},
        "recorded settings": ", ".join(f"{name} {_value(value)}" for name, value in recorded.items()),
    }


def _ancestor(item: Ancestor) -> str:
    head = f"<li><b>{escape(item.parent.kind)}</b> <code>{escape(str(item.path))}</code>"
    known = {"digest": item.parent.digest}
    if item.artifact is None:
        return f'{head} <span class="gone">{STATES[item.state]}</span>{_facts(known)}</li>'
    return f"{head}{_facts({**known, **_origin(item.artifact)})}</li>"


def _origin(artifact: Artifact) -> dict[str, str]:
    manifest = artifact.manifest
    return {
        "command": manifest.command,
        "seed": str(manifest.seed),
        "created": manifest.created,
        "ifo version": manifest.ifo_version,
    }


def _facts(facts: dict[str, str]) -> str:
    coded = ("file", "sha256", "digest", "command")
    lines = []
    for name, value in facts.items():
        text = escape(value)
        lines.append(f"<dt>{escape(name)}</dt><dd>{f'<code>{text}</code>' if name in coded else text}</dd>")
    return f"<dl>{''.join(lines)}</dl>"


def _value(value: Any) -> str:
    if value is None or value == {}:
        return "unknown"
    return value if isinstance(value, str) and value else json.dumps(value)
