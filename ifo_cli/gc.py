"""`ifo gc`: list, and with --delete remove, what is not needed."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from artifacts.errors import ArtifactError, PlatformError
from ifo_cli.options import FoldersArgument, Given, stage_command
from ifo_cli.streams import emit
from ifo_cli.wording import count_text, size_text, table_text
from stages.config.inventory import CLEANED, RUNS, CleanConfig
from stages.runtime.terminal import say

if TYPE_CHECKING:
    from stages.inventory.cleaning import Item, Plan
    from stages.inventory.removal import Outcome

EXAMPLES = (
    "ifo gc",
    "ifo gc runs --delete",
    "ifo gc runs results --include unused --include orphans",
)
NOTE = "\n\n".join(
    (
        "Leftovers, always: temporary files of killed commands, and checkpoints of finished runs. With --include:",
        "  orphans: MP4s, pictures and TensorBoard folders whose artifact is gone",
        "  superseded: artifacts made from a file that was made again with another result",
        "  unused: artifacts that no evaluation was made from, and that their commands can make again",
    )
)


@stage_command("gc")
def gc(
    given: Given,
    folders: FoldersArgument = None,
) -> None:
    """List files that are not needed, with their size and the reason. Nothing is removed without --delete.

    Evaluations are never removed, and neither is anything that a kept file was made from, nor what a running command
    uses, nor what changed less than an hour ago. Files in other folders are not seen: name all folders that hold files
    made from these.
    """
    config = CleanConfig(**given.config)
    config.validate(given.config)
    searched = folders or [Path(RUNS)]
    for folder in searched:
        if os.path.lexists(folder) and not os.path.isdir(folder):
            raise ArtifactError(f"{folder}: is a file: name the folder that holds it")
    from stages.inventory.cleaning import plan
    from stages.inventory.removal import remove

    found, as_json = plan(searched, config.include), bool(given.get("json"))
    for note in found.notes:
        say(f"ifo: {note}")
    if not config.delete:
        emit(json.dumps(_as_json(found, [])) if as_json else _as_text(found, searched, config.include))
        return
    outcomes = []
    for outcome in remove(found.items):
        outcomes.append(outcome)
        if outcome.reason:
            say(f"ifo: {outcome.item.path}: kept: {outcome.reason}")
        elif not as_json:
            emit(f"removed {outcome.item.path} ({size_text(outcome.item.bytes)})")
    gone = [outcome.item for outcome in outcomes if not outcome.reason]
    emit(json.dumps(_as_json(found, outcomes)) if as_json else f"removed {_amount(gone)}")
    if any(outcome.error for outcome in outcomes):
        raise typer.Exit(PlatformError.exit_code)


def _as_text(found: Plan, searched: Sequence[Path], include: Sequence[str]) -> str:
    parts = []
    if found.items:
        rows = [(str(item.path), item.category, size_text(item.bytes), item.reason) for item in found.items]
        parts.append(table_text(("path", "category", "size", "reason"), rows, right=("size",)))
        words = ["ifo", "gc", *map(str, searched), *(word for name in include for word in ("--include", name))]
        parts.append(f"{_amount(found.items)}; to remove them: {shlex.join([*words, '--delete'])}")
    else:
        parts.append("nothing to remove")
    for name in CLEANED:
        more = [item for item in found.others if item.category == name]
        if more:
            parts.append(f"with --include {name}: {_amount(more)}")
    if found.kept:
        kept = size_text(sum(item.bytes for item in found.kept))
        parts.append(f"kept: {count_text(len(found.kept), 'artifact')}, {kept} (--json gives the reasons)")
    return "\n".join(parts)


def _amount(items: Sequence[Item]) -> str:
    return f"{count_text(len(items), 'item')}, {size_text(sum(item.bytes for item in items))}"


def _as_json(found: Plan, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    reasons = {outcome.item.path: outcome.reason for outcome in outcomes}
    return {
        "items": [
            {
                **_described(item),
                "removed": reasons.get(item.path) == "",
                **({"problem": reasons[item.path]} if reasons.get(item.path) else {}),
            }
            for item in found.items
        ],
        "others": [_described(item) for item in found.others],
        "kept": [
            {"path": str(item.path), "kind": item.kind, "bytes": item.bytes, "reason": item.reason}
            for item in found.kept
        ],
        "notes": found.notes,
    }


def _described(item: Item) -> dict[str, Any]:
    return {"path": str(item.path), "category": item.category, "bytes": item.bytes, "reason": item.reason}
