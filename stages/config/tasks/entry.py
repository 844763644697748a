"""What is known of a task without importing a simulator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

# Preset -> stage -> field -> value, where the task needs another value than the preset has. In place of a field there
# may stand a learner or a network (`gps`, `real`), with the fields that hold only with it.
TaskDefaults = Mapping[str, Mapping[str, Mapping[str, Any]]]


@dataclass(frozen=True)
class TaskEntry:
    """A task of ours.

    Attributes:
        name: What the command line calls it; where it ends with a colon, what such names begin with.
        where: MODULE:ATTR of its class.
        household: Whether a person demonstrates it, in place of a trained expert.
        defaults: What it needs otherwise than the presets; the class has the same attribute.
    """

    name: str
    where: str
    household: bool = False
    defaults: TaskDefaults = field(default_factory=dict)
