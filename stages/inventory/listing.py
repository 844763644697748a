"""The artifacts in folders: what each is, how good it is, and whether it still has the files that it was made from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from artifacts import KINDS
from artifacts.family import Family
from artifacts.glance import Glance
from artifacts.survey import Problem, distinct, survey
from stages.config.inventory import SORTS
from stages.inventory.figures import figures_of, key_figure
from stages.inventory.leftovers import artifact_of, created, is_finished
from stages.reporting.methods import of_demos, of_policy, of_translation, of_translator
from stages.reporting.names import method_name

CHECKPOINT = "checkpoint"


@dataclass(frozen=True)
class Row:
    """An artifact in the listing.

    Attributes:
        found: The file.
        task: Name of its task or environment; empty: none is recorded.
        method: Name of the method as in reports; of a translator or translation, that of policies learned from it.
        figures: All figures of the artifact, JSON-ready.
        key: The figures that matter, in a few words.
        created: When it was made.
        intact: State of the parent that is worst off; empty: it has no parents.
        parents: Kind, path and state of each parent, JSON-ready.
        above: Paths of the rows that it was made from.
    """

    found: Glance
    task: str
    method: str
    figures: dict[str, Any]
    key: str
    created: datetime
    intact: str
    parents: list[dict[str, str]]
    above: list[Path]

    @property
    def path(self) -> Path:
        return self.found.path

    @property
    def kind(self) -> str:
        return self.found.kind


@dataclass(frozen=True)
class Listing:
    """The rows of the artifacts in folders, sorted, and what is there that cannot be read."""

    rows: list[Row]
    problems: list[Problem]


def listing(folders: Sequence[Path], kinds: Sequence[str] = (), sort: str = "kind") -> Listing:
    """List the artifacts in folders and their subfolders, checkpoints of unfinished runs included.

    Only manifests are read, and metrics of files by an older ifo.

    Args:
        folders: Folders to search; files among them are listed as well.
        kinds: Kinds to list; empty: all.
        sort: One of `SORTS`: in the order of the pipeline, the largest first, the newest first, or by path.

    Raises:
        ArtifactError: A folder does not exist or cannot be read.
    """
    found = survey(folders)
    family = Family(distinct(found))
    rows = [_row(item, family) for item in family.members if not kinds or item.kind in kinds]
    return Listing(sorted(rows, key=_KEYS[sort]), found.problems)


def tree(rows: Sequence[Row]) -> list[tuple[int, Row]]:
    """Return each row once with its depth, below the first of the rows that it was made from."""
    known = {row.path for row in rows}
    below: dict[Path | None, list[Row]] = {}
    for row in rows:
        parent = next((path for path in row.above if path in known), None)
        below.setdefault(parent, []).append(row)
    ordered: list[tuple[int, Row]] = []
    shown: set[Path] = set()
    # A forged file may name its own descendant as its parent: such circles begin at their first row.
    for first in [*below.get(None, []), *rows]:
        waiting = [(0, first)]
        while waiting:
            depth, row = waiting.pop()
            if row.path not in shown:
                shown.add(row.path)
                ordered.append((depth, row))
                waiting.extend((depth + 1, child) for child in reversed(below.get(row.path, [])))
    return ordered


def _row(item: Glance, family: Family) -> Row:
    figures = figures_of(item) if item.kind != CHECKPOINT else {}
    relations = family.parents(item)
    return Row(
        item,
        _task(item.manifest.config),
        _method(item, family),
        figures,
        key_figure(item.kind, figures) if item.kind != CHECKPOINT else _progress(item, family),
        created(item),
        family.state(item),
        [{"kind": one.parent.kind, "path": str(one.path), "state": one.state} for one in relations],
        [source.path for source in family.sources(item)],
    )


def _task(config: dict[str, Any]) -> str:
    environment = config.get("environment")
    return str(config.get("task") or (environment["name"] if environment else ""))


def _progress(item: Glance, family: Family) -> str:
    """Return what has become of the run of a checkpoint, in a few words."""
    artifact = next((one for one in family.members if one.path == artifact_of(item.path)), None)
    if is_finished(item, artifact):
        return "left by a finished run"
    stage = str(item.manifest.config.get("stage") or "")
    return f"unfinished {stage}".strip()


def _method(item: Glance, family: Family) -> str:
    """Return the name of an artifact's method; empty if it has none, or does not record it properly."""
    try:
        name = _NAMED[item.kind](item, family) if item.kind in _NAMED else ""
    except (AttributeError, LookupError, TypeError, ValueError):  # values of other types in a forged file
        return ""
    return name


def _of_runs(item: Glance, _: Family) -> str:
    return ", ".join(dict.fromkeys(method_name(run) for run in item.manifest.config["runs"]))


def _of_learned(item: Glance, family: Family) -> str:
    described = of_policy(item.manifest.config)
    translation = family.parent(item, "translation")
    return method_name(described | _behind_translation(translation, family))


def _of_target(item: Glance, family: Family) -> str:
    return method_name(of_policy({"reward": "translation"}) | _behind_translation(item, family))


def _of_translator(item: Glance, family: Family) -> str:
    return method_name(of_policy({"reward": "translation"}) | _behind_translator(item, family))


def _behind_translation(item: Glance | None, family: Family) -> dict[str, Any]:
    if item is None:
        return {}
    return of_translation(item.manifest.config) | _behind_translator(family.parent(item, "translator"), family)


def _behind_translator(item: Glance | None, family: Family) -> dict[str, Any]:
    if item is None:
        return {}
    demos = family.parent(item, "demos")
    return of_translator(item.manifest.config) | ({} if demos is None else of_demos(demos.manifest.config))


def _of_expert(item: Glance, _: Family) -> str:
    return str(item.manifest.config.get("learner") or "")


_NAMED: dict[str, Callable[[Glance, Family], str]] = {
    "expert": _of_expert,
    "translator": _of_translator,
    "translation": _of_target,
    "policy": _of_learned,
    "evaluation": _of_runs,
}
_KEYS: dict[str, Callable[[Row], Any]] = dict(
    zip(
        SORTS,
        (
            lambda row: (list(KINDS).index(row.kind), row.path),
            lambda row: (-row.found.bytes, row.path),
            lambda row: (-row.created.timestamp(), row.path),
            lambda row: row.path,
        ),
        strict=True,
    )
)
