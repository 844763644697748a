"""Defaults of the household task ladle-almonds."""

from stages.config.tasks.entry import TaskEntry
from stages.config.tasks.household import household

TASK = TaskEntry(
    "ladle-almonds",
    "stages.simulation.tasks.household_ladle:LadleAlmonds",
    household=True,
    # The paper has 60 demonstrations, but our translators overfit to so few.
    defaults=household(demos=180, fine_blur=3.0, rollouts=(50, 10)),
)
