"""The built-in tasks with their own defaults, in the order of the help texts. Light imports only."""

from __future__ import annotations

from stages.config.tasks import (
    dm,
    ladle_almonds,
    push,
    push_real,
    reach,
    strike,
    sweep,
    sweep_almonds,
    sweep_paper,
)
from stages.config.tasks.entry import TaskDefaults, TaskEntry

_MODULES = reach, push, sweep, strike, push_real, sweep_paper, sweep_almonds, ladle_almonds, dm
ENTRIES: dict[str, TaskEntry] = {module.TASK.name: module.TASK for module in _MODULES}


def entry(name: str) -> TaskEntry | None:
    """Return the entry of the built-in task `name`, for example `dm:reacher-easy`; None: it is not a built-in task."""
    family, colon, _ = name.partition(":")
    return ENTRIES.get(family + colon if colon else name)


def own_defaults(name: str) -> TaskDefaults:
    """Return the own defaults of the built-in task `name`; empty: it has none, or is not a built-in task."""
    found = entry(name)
    return found.defaults if found else {}
