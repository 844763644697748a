"""Tasks by name: the paper's, dm_control's suite, and whatever users bring."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import importlib.metadata
import inspect
import os
from collections.abc import Callable
from pathlib import Path

from artifacts.errors import UsageError
from stages.runtime.seeding import generator
from stages.simulation.contexts import DISTRIBUTIONS, FACTORS, ContextDistribution, Contexts
from stages.simulation.task import Task

GROUP = "ifo.tasks"  # entry points of installed packages
TRUSTED = "IFO_TASKS"  # environment variable: comma-separated MODULE:ATTR that files may name


def make_task(name: str, typed: bool = False) -> Task:
    """The task called `name`.

    Args:
        name: One of the paper's; `dm:DOMAIN-TASK`; the name of an entry point of the group `ifo.tasks`; or
            `MODULE:ATTR`, a subclass of Task or a function that returns a task.
        typed: Whether the user typed the name. A `MODULE:ATTR` that comes from a file is imported only if the
            environment variable IFO_TASKS lists it: opening a stranger's file must not run code.

    Raises:
        UsageError: There is no such task, or it may not be imported.
    """
    from stages.simulation.tasks.household_ladle import LadleAlmonds
    from stages.simulation.tasks.household_push import PushReal
    from stages.simulation.tasks.household_sweep import SweepAlmonds, SweepPaper
    from stages.simulation.tasks.push import Push
    from stages.simulation.tasks.reach import Reach
    from stages.simulation.tasks.strike import Strike
    from stages.simulation.tasks.sweep import Sweep

    kinds = Reach, Push, Sweep, Strike, PushReal, SweepPaper, SweepAlmonds, LadleAlmonds
    tasks: dict[str, type[Task]] = {task.name: task for task in kinds}
    if name in tasks:
        return tasks[name]()
    if name.startswith("dm:"):
        from stages.simulation.tasks.dm import DmTask

        return DmTask(name)
    for entry in importlib.metadata.entry_points(group=GROUP):
        if entry.name == name:
            return _made(name, entry.load)
    if ":" not in name:
        raise UsageError(f"task {name!r}: expected one of {', '.join(tasks)}, dm:DOMAIN-TASK, or MODULE:ATTR")
    trusted = {word.strip() for word in os.environ.get(TRUSTED, "").split(",")}
    if not typed and name not in trusted:
        raise UsageError(
            f"task {name!r} is code that the file names, and code is not run for being named by a file: if you trust "
            f"it, export {TRUSTED}={name}"
        )
    return _made(name, lambda: _attribute(name))


def _attribute(name: str) -> object:
    module, _, attribute = name.partition(":")
    if not module.strip(".") or module.startswith(".") or not attribute:
        raise UsageError(f"task {name!r}: expected MODULE:ATTR, such as my_tasks:Lift")
    made = getattr(importlib.import_module(module), attribute, None)
    if made is None:
        raise UsageError(f"task {name!r}: the module {module} has no {attribute}; is it the right one?")
    return made


def _made(name: str, load: Callable[[], object]) -> Task:
    """The task that a user's code makes.

    Raises:
        UsageError: It cannot be imported, or is no task.
    """
    try:
        made = load()
        task = made() if callable(made) else made
    except UsageError:
        raise
    except ModuleNotFoundError as error:
        raise UsageError(f"task {name!r}: {error}; is its module installed or on PYTHONPATH?") from error
    except Exception as error:  # A stranger's code may fail in any way, and none of them is a bug of ours.
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise UsageError(f"task {name!r} cannot be made ({reason}): mend its code") from error
    if not isinstance(task, Task):
        raise UsageError(f"task {name!r} is a {type(task).__name__}, expected a stages.simulation.task.Task")
    task.name = name  # What later stages find it by.
    return task


def code_digest(task: Task) -> dict[str, str]:
    """The SHA-256 of a user's task file, as `{"task_code": ...}`, so that a changed task makes new artifacts.

    Empty for tasks of this package, whose code belongs to the version of ifo.
    """
    try:
        path = inspect.getsourcefile(type(task))
        if path is None or type(task).__module__.partition(".")[0] == __name__.partition(".")[0]:
            return {}
        return {"task_code": hashlib.sha256(Path(path).read_bytes()).hexdigest()}
    except (OSError, TypeError):
        return {}


def file_name(task_name: str) -> str:
    """The task's name as part of a file name."""
    return task_name.replace(":", "-").replace("/", "-")


def distribution(name: str, vary: str = "") -> ContextDistribution:
    """The context distribution called `name`.

    Args:
        vary: Comma-separated factors to vary in place of the task's own choice; empty: those.

    Raises:
        UsageError: There is no such distribution or factor.
    """
    if name not in DISTRIBUTIONS:
        raise UsageError(f"--contexts {name!r}: expected one of {', '.join(DISTRIBUTIONS)}")
    if not vary:
        return DISTRIBUTIONS[name]
    factors = frozenset(word.strip() for word in vary.split(","))
    if unknown := sorted(factors - set(FACTORS)):
        raise UsageError(f"--vary {unknown[0]!r}: expected some of {', '.join(FACTORS)}, separated by commas")
    return dataclasses.replace(DISTRIBUTIONS[name], vary=factors)


def learner_context(task: Task, context_seed: int, drawn_from: ContextDistribution) -> Contexts:
    """The learner's context omega_l (leading axis 1): a stream of its own, which no demonstration is drawn from."""
    return task.draw_contexts(generator(context_seed, "learner-context"), 1, drawn_from)
