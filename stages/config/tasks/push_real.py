"""Defaults of the household task push-real."""

from stages.config.tasks.entry import TaskEntry
from stages.config.tasks.household import household

TASK = TaskEntry(
    "push-real",
    "stages.simulation.tasks.household_push:PushReal",
    household=True,
    # A wide blur suffices, because the can is large.
    defaults=household(demos=135, fine_blur=0.0, rollouts=(25, 20)),
)
