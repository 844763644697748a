"""Defaults of the task push."""

from typing import Any

from stages.config.tasks.entry import TaskEntry

# The expert learns more slowly than in reach. Colors distinguish the object from the goal and must not be swapped.
_LONGER: dict[str, Any] = {"train-expert": {"iterations": 150}, "train-translator": {"swap_colours": False}}

TASK = TaskEntry("push", "stages.simulation.tasks.push:Push", defaults={"quick": _LONGER, "paper": _LONGER})
