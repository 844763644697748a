"""Defaults of the task sweep."""

from typing import Any

from stages.config.tasks.entry import TaskEntry

_LONGER: dict[str, Any] = {"train-expert": {"iterations": 100}, "train-translator": {"swap_colours": False}}

TASK = TaskEntry("sweep", "stages.simulation.tasks.sweep:Sweep", defaults={"quick": _LONGER, "paper": _LONGER})
