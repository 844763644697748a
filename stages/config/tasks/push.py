"""Defaults of the task push."""

from typing import Any

from stages.config.tasks.entry import TaskEntry

# Its expert learns more slowly than reach's. Colours tell the object from the goal, and so must not be swapped.
_LONGER: dict[str, Any] = {"train-expert": {"iterations": 150}, "train-translator": {"swap_colours": False}}

TASK = TaskEntry("push", "stages.simulation.tasks.push:Push", defaults={"quick": _LONGER, "paper": _LONGER})
