"""Names of tasks: built in, installed by packages, or MODULE:ATTR; and which of them artifacts may name.

As `stages.config.stages`, this module imports nothing heavy.
"""

from __future__ import annotations

import difflib
import os
from importlib import metadata

from artifacts.errors import UsageError
from stages.config.stages import HOUSEHOLD, TASKS

GROUP = "ifo.tasks"  # entry points of installed packages
TRUSTED = "IFO_TASKS"  # environment variable: comma-separated MODULE:ATTR that artifacts may name
SUITE = "dm:"


def plugins() -> dict[str, metadata.EntryPoint]:
    """Tasks that installed packages offer: name -> entry point."""
    return {entry.name: entry for entry in metadata.entry_points(group=GROUP)}


def known_tasks() -> tuple[str, ...]:
    """Names of all tasks that have a plain name: built-in ones first, then those of plug-ins."""
    built_in = (*TASKS, *HOUSEHOLD)
    return (*built_in, *(name for name in plugins() if name not in built_in))


def check_task_name(name: str) -> str:
    """Return the name if there may be such a task; what follows a colon is looked up later.

    Raises:
        UsageError: There is no such task; the message says which one may have been meant.
    """
    known = known_tasks()
    if name in known or ":" in name:
        return name
    close = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
    meant = f", did you mean {close[0]}?" if close else ":"
    raise UsageError(f"no task {name!r}{meant} expected one of {', '.join(known)}, dm:DOMAIN-TASK, or MODULE:ATTR")


def is_trusted(name: str) -> bool:
    """Whether a task that an artifact names may be imported."""
    listed = {word.strip() for word in os.environ.get(TRUSTED, "").split(",")}
    return ":" not in name or name.startswith(SUITE) or name in listed or name in plugins()


def permission_needed(name: str) -> str:
    """What the user must do so that later stages can use the task; empty: nothing."""
    if not name or is_trusted(name):
        return ""
    return f"later stages import {name} only with your permission: export {TRUSTED}={name}"
