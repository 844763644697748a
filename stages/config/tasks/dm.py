"""Defaults of the tasks in dm_control's suite, `dm:DOMAIN-TASK`."""

from typing import Any

from stages.config.tasks.entry import TaskEntry

_EXPERT: dict[str, Any] = {
    "learner": "sac",
    "hidden": 128,
    "discount": 0.99,
    "test_contexts": 50,
    "test_episodes": 4,
}
_FULL = {
    "train-expert": {**_EXPERT, "iterations": 60, "episodes": 4, "updates": 0.25},
    "collect-demos": {"n": 1024},
    "learn-policy": {"iterations": 100, "episodes": 20},
    "evaluate": {"episodes": 20},
}
_TOY = {
    "train-expert": {**_EXPERT, "iterations": 2, "episodes": 2, "test_contexts": 4, "test_episodes": 2},
    "collect-demos": {"n": 32},
    "learn-policy": {"iterations": 2, "episodes": 4},
    "evaluate": {"episodes": 2},
}

TASK = TaskEntry("dm:", "stages.simulation.tasks.dm:DmTask", defaults={"toy": _TOY, "quick": _FULL, "paper": _FULL})
