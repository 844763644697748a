"""Names of tasks (built-in, from installed packages, or MODULE:ATTR), and permission for artifacts to name them.

Like `stages.config.stages`, this module imports nothing heavy.
"""

from __future__ import annotations

import difflib
import os
from importlib import metadata

from artifacts.errors import UsageError
from stages.config.stages import HOUSEHOLD, TASKS

GROUP = "ifo.tasks"  # entry points of installed packages
TRUSTED = "IFO_TASKS"  # environment variable: comma-separated list of MODULE:ATTR that artifacts may name
SUITE = "dm:"


def plugins() -> dict[str, metadata.EntryPoint]:
    """Return the tasks of installed packages: name -> entry point."""
    return {entry.name: entry for entry in metadata.entry_points(group=GROUP)}


def known_tasks() -> tuple[str, ...]:
    """Return the plain names of tasks: first those of built-in tasks, then those of plug-ins."""
    built_in = (*TASKS, *HOUSEHOLD)
    return (*built_in, *(name for name in plugins() if name not in built_in))


def check_task_name(name: str) -> str:
    """Return the name if such a task may exist; names with a colon are looked up later.

    Raises:
        UsageError: There is no such task; the message suggests a similar name.
    """
    known = known_tasks()
    if name in known or ":" in name:
        return name
    close = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
    meant = f", did you mean {close[0]}?" if close else ":"
    raise UsageError(f"no task {name!r}{meant} expected one of {', '.join(known)}, dm:DOMAIN-TASK, or MODULE:ATTR")


def is_trusted(name: str) -> bool:
    """Return whether a task that an artifact names may be imported."""
    listed = {word.strip() for word in os.environ.get(TRUSTED, "").split(",")}
    return ":" not in name or name.startswith(SUITE) or name in listed or name in plugins()


def permission_needed(name: str) -> str:
    """Return what the user must do so that later stages can import the task; empty: nothing."""
    if not name or is_trusted(name):
        return ""
    return f"later stages import {name} only with your permission: export {TRUSTED}={name}"
