"""Defaults of the household task sweep-almonds."""

from stages.config.tasks.entry import TaskEntry
from stages.config.tasks.household import household

TASK = TaskEntry(
    "sweep-almonds",
    "stages.simulation.tasks.household_sweep:SweepAlmonds",
    household=True,
    defaults=household(demos=100, fine_blur=3.0, rollouts=(50, 10)),
)
