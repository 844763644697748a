"""`ifo ls`: list the artifacts in folders."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from artifacts.errors import UsageError
from ifo_cli.options import FoldersArgument, Given, stage_command
from ifo_cli.streams import emit, plain
from ifo_cli.wording import age_text, count_text, size_text, table_text
from stages.config.inventory import RUNS, ListConfig
from stages.runtime.terminal import say

if TYPE_CHECKING:
    from artifacts.survey import Problem
    from stages.inventory.listing import Listing, Row

EXAMPLES = (
    "ifo ls",
    "ifo ls runs --tree",
    "ifo ls runs --kind demos --sort size",
)
HEADS = ("path", "kind", "task", "method", "key figures", "size", "age", "parents")


@stage_command("ls")
def ls(
    given: Given,
    folders: FoldersArgument = None,
) -> None:
    """List artifacts: task, method, key figures, size, age, and whether the files they were made from are unchanged.

    Subfolders are searched too. Checkpoints of unfinished runs are listed with the artifacts, and files that are
    damaged or not an artifact below them. This command does not read the data: `ifo verify` checks it.
    """
    config = ListConfig(**given.config)
    config.validate(given.config)
    if config.tree and given.get("json"):
        raise UsageError("--tree has no effect with --json: leave one of the two out")
    from stages.inventory.listing import listing

    searched = folders or [Path(RUNS)]
    found = listing(searched, config.kind, config.sort)
    if given.get("json"):
        emit(json.dumps(_as_json(found)))
        return
    if found.rows:
        emit(_as_text(found, config.tree))
    else:
        say(f"ifo: no artifacts in {', '.join(map(str, searched))}")
    for problem in found.problems:
        emit(_line(problem))


def _as_text(found: Listing, as_tree: bool) -> str:
    from stages.inventory.listing import tree

    now = time.time()
    ordered = tree(found.rows) if as_tree else [(0, row) for row in found.rows]
    table = table_text(HEADS, [_cells(depth, row, now) for depth, row in ordered], right=("size", "age"))
    total = size_text(sum(row.found.bytes for row in found.rows))
    return f"{table}\n{count_text(len(found.rows), 'file')}, {total}"


def _cells(depth: int, row: Row, now: float) -> tuple[str, ...]:
    age = age_text(now - row.created.timestamp())
    name = "  " * depth + str(row.path)
    return name, row.kind, row.task, row.method, row.key, size_text(row.found.bytes), age, row.intact


def _line(problem: Problem) -> str:
    return f"{problem.path}: {'not an artifact' if problem.foreign else problem.reason}"


def _as_json(found: Listing) -> dict[str, Any]:
    artifacts = [
        {
            "path": str(row.path),
            "kind": row.kind,
            "task": row.task,
            "method": row.method,
            "key_figures": row.key,
            "figures": plain(row.figures),
            "bytes": row.found.bytes,
            "created": row.created.isoformat(),
            "seed": row.found.manifest.seed,
            "command": row.found.manifest.command,
            "intact": row.intact,
            "parents": row.parents,
        }
        for row in found.rows
    ]
    problems = [{"path": str(one.path), "reason": one.reason, "foreign": one.foreign} for one in found.problems]
    return {"artifacts": artifacts, "problems": problems}
