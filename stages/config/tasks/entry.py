"""Information about a task that is available without importing a simulator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

# Preset -> stage -> field -> value, for values that differ from the preset's. Instead of a field there may be a learner
# or a network (`gps`, `real`), with the fields and values that apply only to it.
TaskDefaults = Mapping[str, Mapping[str, Mapping[str, Any]]]


@dataclass(frozen=True)
class TaskEntry:
    """A built-in task.

    Attributes:
        name: Name on the command line, or a prefix of such names if it ends with a colon.
        where: MODULE:ATTR of the task's class.
        household: Whether a scripted demonstrator demonstrates the task, instead of a trained expert.
        defaults: Defaults that differ from the presets; the class has the same attribute.
    """

    name: str
    where: str
    household: bool = False
    defaults: TaskDefaults = field(default_factory=dict)
