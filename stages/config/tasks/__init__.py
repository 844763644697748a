"""The tasks of ours, in the order in which help texts list them, each with its own defaults. Light imports only."""

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
    """The task of ours that is called `name`, such as `reach` or `dm:reacher-easy`; None: it is none of ours."""
    family, colon, _ = name.partition(":")
    return ENTRIES.get(family + colon if colon else name)


def own_defaults(name: str) -> TaskDefaults:
    """What the task of ours that is called `name` needs otherwise than the presets; empty: nothing, or not ours."""
    found = entry(name)
    return found.defaults if found else {}
