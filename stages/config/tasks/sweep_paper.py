"""Defaults of the household task sweep-paper."""

from stages.config.tasks.entry import TaskEntry
from stages.config.tasks.household import household

TASK = TaskEntry(
    "sweep-paper",
    "stages.simulation.tasks.household_sweep:SweepPaper",
    household=True,
    defaults=household(demos=85, fine_blur=3.0, rollouts=(50, 10)),
)
