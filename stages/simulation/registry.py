"""Tasks by name: the paper's, dm_control's suite, and those of users."""

from __future__ import annotations

import dataclasses
import importlib
import sys
from collections.abc import Callable
from pathlib import Path

from artifacts import IfoError, UsageError, sha256_of
from stages.config.task_names import SUITE, TRUSTED, check_task_name, is_trusted, plugins
from stages.runtime.seeding import generator
from stages.simulation.blame import definition, failure, modules_of
from stages.simulation.contexts import DISTRIBUTIONS, FACTORS, ContextDistribution, Contexts
from stages.simulation.guard import attribute_faults, guarded
from stages.simulation.task import Task


def make_task(name: str, typed: bool = False) -> Task:
    """The task called `name`; a user's task is guarded (`stages.simulation.guard`).

    Args:
        name: One of the built-in tasks; `dm:DOMAIN-TASK`; the name of an entry point of the group `ifo.tasks`; or
            `MODULE:ATTR`, a subclass of Task or a function that returns a task.
        typed: Whether the user typed the name. A `MODULE:ATTR` that comes from a file is imported only if the
            environment variable IFO_TASKS lists it: opening a stranger's file must not run code.

    Raises:
        UsageError: There is no such task, it may not be imported, or (TaskError) it is broken.
    """
    if task := _built_in(name):
        return task
    task = guarded(_brought(name, typed))
    for error in attribute_faults(task):
        raise error
    return task


def unguarded_task(name: str, typed: bool = False) -> Task:
    """As `make_task`, but neither guarded nor checked."""
    return _built_in(name) or _brought(name, typed)


def _built_in(name: str) -> Task | None:
    """The task of this package called `name`; None: there is none."""
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
    if name.startswith(SUITE):
        from stages.simulation.tasks.dm import DmTask

        return DmTask(name)
    return None


def _brought(name: str, typed: bool) -> Task:
    """The task that a user's code makes.

    Raises:
        UsageError: It cannot be imported, or is no task.
    """
    entry = plugins().get(check_task_name(name))
    if not entry and not typed and not is_trusted(name):
        raise UsageError(
            f"task {name!r} is code that the file names, and code that a file names is imported only with your "
            f"permission: if you trust it, export {TRUSTED}={name}"
        )
    load: Callable[[], object] = entry.load if entry else lambda: _attribute(name)
    module = entry.module if entry else name.partition(":")[0]
    made: object = None
    try:
        made = load()
        task = made() if callable(made) else made
    except IfoError:
        raise
    except (Exception, SystemExit) as error:  # A user's code may fail in any way, and none of them is a bug of ours.
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] == module.partition(".")[0]:
            raise UsageError(f"task {name!r}: {error}; is its module installed or on PYTHONPATH?") from error
        place = definition(made) if isinstance(made, type) else ""
        raise UsageError(f"task {name!r} cannot be made {failure(error, [module], place)}; fix its code") from error
    if not isinstance(task, Task):
        raise UsageError(f"task {name!r} is a {type(task).__name__}, expected an ifo.Task")
    task.name = name  # What later stages find it by.
    return task


def _attribute(name: str) -> object:
    module, _, attribute = name.partition(":")
    if not module.strip(".") or module.startswith(".") or not attribute:
        raise UsageError(f"task {name!r}: expected MODULE:ATTR, such as my_tasks:Lift")
    made = getattr(importlib.import_module(module), attribute, None)
    if made is None:
        raise UsageError(f"task {name!r}: the module {module} has no {attribute}; is it the right one?")
    return made


def code_digest(task: Task) -> dict[str, str]:
    """The SHA-256 of a user's task file, as `{"task_code": ...}`, so that a changed task makes new artifacts.

    Empty for tasks of this package, whose code belongs to the version of ifo.
    """
    files = [getattr(sys.modules.get(name), "__file__", None) for name in sorted(modules_of(task.__class__))]
    digests = [sha256_of(file) for file in files if file and Path(file).is_file()]
    return {"task_code": " ".join(digests)} if digests else {}


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
