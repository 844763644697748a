"""Tasks by name."""

from __future__ import annotations

from artifacts.errors import UsageError
from stages.simulation.contexts import DISTRIBUTIONS, ContextDistribution
from stages.simulation.task import Task


def make_task(name: str) -> Task:
    """The task called `name`.

    Raises:
        UsageError: There is no such task.
    """
    from stages.simulation.reach import Reach

    tasks: dict[str, type[Task]] = {task.name: task for task in (Reach,)}
    if name not in tasks:
        raise UsageError(f"task {name!r}: expected one of {', '.join(tasks)}")
    return tasks[name]()


def distribution(name: str) -> ContextDistribution:
    """The context distribution called `name`.

    Raises:
        UsageError: There is no such distribution.
    """
    if name not in DISTRIBUTIONS:
        raise UsageError(f"--contexts {name!r}: expected one of {', '.join(DISTRIBUTIONS)}")
    return DISTRIBUTIONS[name]
