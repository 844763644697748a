"""Defaults of the task strike."""

from typing import Any

from stages.config.tasks.entry import TaskEntry

_LONGER: dict[str, Any] = {"train-expert": {"iterations": 200}, "train-translator": {"swap_colours": False}}
_QUICK: dict[str, Any] = {
    **_LONGER,
    # R_feat keeps the arm away from the ball (results/LOG.md).
    "learn-policy": {"image_weight": 8.0},
}

TASK = TaskEntry("strike", "stages.simulation.tasks.strike:Strike", defaults={"quick": _QUICK, "paper": _LONGER})
