"""Removal of what a plan lists, and of nothing else."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from artifacts.interrupts import deferred_interrupts
from artifacts.usage import unused
from stages.inventory.cleaning import ORPHANS, TEMPORARY, Item, state_of
from stages.inventory.leftovers import has_owner, is_companion


@dataclass(frozen=True)
class Outcome:
    """What became of an item: `reason` says why it is still there, and is empty if it is gone.

    Attributes:
        error: Whether the file system refused to remove it.
    """

    item: Item
    reason: str = ""
    error: bool = False


def remove(items: Sequence[Item]) -> Iterator[Outcome]:
    """Remove the items of a plan in their order, and yield what became of each.

    An item stays if it has changed since the plan was made, if a command that began since uses it, or if anything that
    was made from it is still there. After an interrupt, some of the items are gone, and none of the others is broken.
    """
    for item in items:
        left = next((path for path in item.after if os.path.lexists(path)), None)
        if left is not None:
            yield Outcome(item, f"{left} is still there")
            continue
        try:
            reason = _remove(item)
        except OSError as error:
            yield Outcome(item, f"cannot be removed ({error.strerror})", error=True)
        else:
            yield Outcome(item, reason)


def _remove(item: Item) -> str:
    """Remove a file or folder; return why it stays, or an empty text."""
    with unused(item.path) as free:
        if not free:
            return "in use by a running command"
        if state_of(item.path) != item.state or os.path.islink(item.path):
            return "changed since it was listed"
        if item.category == ORPHANS and has_owner(item.path):
            return "its artifact is there again"
        with deferred_interrupts():  # A folder is removed as a whole.
            if not os.path.isdir(item.path):
                os.unlink(item.path)
            elif item.category == TEMPORARY:
                shutil.rmtree(item.path)
            elif is_companion(item.path):
                _remove_scalars(item.path)
            else:
                return "holds files that are not of TensorBoard"
    return ""


def _remove_scalars(folder: Path) -> None:
    for name in os.listdir(folder):
        os.unlink(folder / name)
    os.rmdir(folder)
