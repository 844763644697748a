"""`ifo inspect`: show what an artifact is, what it holds and what it was made from."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ifo_cli.options import Given, stage_command
from ifo_cli.streams import emit, inputs_or_stdin, plain
from ifo_cli.wording import size_text
from stages.runtime.terminal import one_line

if TYPE_CHECKING:
    from artifacts import Artifact

EXAMPLES = (
    "ifo inspect runs/reach-c0.policy.h5",
    "ifo inspect runs/reach-c0.evaluation.h5 --json",
)
NARROWEST = 100  # minimum width in columns of a table that is not printed to a terminal
SHOWN_VALUES = 200  # of the configuration
SHOWN_DATASETS = 40


@stage_command("inspect")
def inspect(
    given: Given,
    artifact: Annotated[
        Path | None, typer.Argument(readable=False, help="Artifact (default: the path on standard input).")
    ] = None,
) -> None:
    """Show an artifact's origin, configuration, data, key figures and lineage.

    This command does not check the data: `ifo verify` does.
    """
    from artifacts import read_artifact

    path = inputs_or_stdin([artifact] if artifact else [], "the artifact to inspect")[0]
    report = describe(read_artifact(path))
    if given.get("json"):
        emit(json.dumps(report))
    else:
        emit(_as_text(report))


def describe(artifact: Artifact) -> dict[str, Any]:
    """Return everything about an artifact except its data, as JSON-ready values."""
    from stages.reporting.description import KEY_FIGURES, key_figures

    manifest = artifact.manifest
    datasets = [
        {
            "name": name,
            "shape": list(shape),
            "dtype": str(dtype),
            "bytes": math.prod(shape) * dtype.itemsize,
        }
        for name, (shape, dtype) in artifact.describe().items()
    ]
    return {
        "path": str(artifact.path),
        "bytes": artifact.path.stat().st_size,
        "kind": artifact.kind,
        "schema_version": manifest.schema_version,
        "created": manifest.created,
        "ifo_version": manifest.ifo_version,
        "seed": manifest.seed,
        "command": manifest.command,
        "environment": dict(manifest.environment),
        "config": plain({k: v for k, v in manifest.config.items() if k not in KEY_FIGURES}),
        "key_figures": plain(key_figures(artifact)),
        "datasets": datasets,
        "lineage": list(_lineage(artifact)),
    }


def _lineage(artifact: Artifact) -> Iterator[dict[str, Any]]:
    """Yield ancestors, depth first; a missing, unreadable or changed file ends its branch and is marked as such."""
    from artifacts import ancestors

    for item in ancestors(artifact, check=True):
        entry = {"depth": item.depth, "kind": item.parent.kind, "path": str(item.path), "state": item.state}
        if item.artifact is None:
            yield {**entry, "problem": item.problem}
        else:
            manifest = item.artifact.manifest
            yield {**entry, "created": manifest.created, "seed": manifest.seed, "command": manifest.command}


def _as_text(report: dict[str, Any]) -> str:
    """Format the report as tables."""
    from io import StringIO

    from rich.console import Console
    from rich.table import Table

    from stages.reporting.description import value_text

    width = None if sys.stdout.isatty() else _width(report)
    console = Console(file=StringIO(), width=width, highlight=False, emoji=False)

    def table(title: str, rows: Sequence[tuple[str, ...]], heads: tuple[str, ...] = ()) -> None:
        shown = Table(title=title, title_justify="left", show_header=bool(heads), box=None, pad_edge=False)
        for head in heads or rows[0]:
            numeric = head in ("size",)
            shown.add_column(head if heads else "", overflow="fold", justify="right" if numeric else "left")
        for row in rows:
            shown.add_row(*map(one_line, row))
        console.print(shown, markup=False)
        console.print()

    origin = [(name, str(report[name])) for name in ("path", "kind", "created", "seed", "command")]
    versions = {"ifo": report["ifo_version"], "schema": report["schema_version"], **report["environment"]}
    origin.insert(3, ("versions", ", ".join(f"{name} {value}" for name, value in versions.items() if value)))
    origin.insert(2, ("size", size_text(report["bytes"])))
    table("Artifact", origin)
    for title, values in (("Key figures", report["key_figures"]), ("Configuration", report["config"])):
        if values:
            pairs = [(value_text(name), value_text(value)) for name, value in islice(values.items(), SHOWN_VALUES)]
            table(title, [*pairs, *_more(len(values) - len(pairs), ("",))])
    rows: list[tuple[str, ...]] = [
        (item["name"], "x".join(map(str, item["shape"])) or "single", item["dtype"], size_text(item["bytes"]))
        for item in report["datasets"][:SHOWN_DATASETS]
    ]
    rows += _more(len(report["datasets"]) - len(rows), ("", "", ""))
    if rows:
        table("Datasets", rows, ("name", "shape", "dtype", "size"))
    lineage: list[tuple[str, ...]] = [
        ("  " * (entry["depth"] - 1) + entry["kind"], entry["path"], _ancestor_note(entry))
        for entry in report["lineage"]
    ]
    table("Lineage", lineage or [("made from no other artifact",)])
    text = console.file.getvalue()  # type: ignore[attr-defined]
    return "\n".join(line.rstrip() for line in str(text).splitlines()).rstrip()


def _more(hidden: int, rest: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Return the last row of a table that leaves rows out."""
    return [(f"... {hidden} more (--json shows all)", *rest)] if hidden > 0 else []


def _width(report: dict[str, Any]) -> int:
    values = [report["path"], report["command"], *report["environment"].values()]
    longest = max(len(str(value)) for value in values)
    names = max((len(item["name"]) for item in report["datasets"]), default=0)
    lineage = max((len(entry["path"]) + len(_ancestor_note(entry)) for entry in report["lineage"]), default=0)
    return max(NARROWEST, longest + 20, names + 60, lineage + 40)


def _ancestor_note(entry: dict[str, Any]) -> str:
    if entry["state"] != "present":
        return str(entry["state"])
    return f"seed {entry['seed']}, {entry['created']}"
