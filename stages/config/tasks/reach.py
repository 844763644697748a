"""Defaults of the task reach."""

from stages.config.tasks.entry import TaskEntry

TASK = TaskEntry("reach", "stages.simulation.tasks.reach:Reach")
