"""Creates tasks by name: the paper's, those of dm_control's suite, and users' own."""

from __future__ import annotations

import dataclasses
import importlib
import sys
from collections.abc import Callable
from pathlib import Path

from artifacts import IfoError, UsageError, sha256_of
from stages.config.contexts import parse_factors
from stages.config.task_names import TRUSTED, check_task_name, is_trusted, plugins
from stages.config.tasks import entry, own_defaults
from stages.config.tasks.entry import TaskDefaults
from stages.config.values import checked_defaults
from stages.runtime.seeding import generator
from stages.simulation.blame import definition, failure, modules_of
from stages.simulation.contexts import DISTRIBUTIONS, ContextDistribution, Contexts
from stages.simulation.gl import choose_backend
from stages.simulation.guard import attribute_faults, guarded
from stages.simulation.task import Task


def make_task(name: str, typed: bool = False) -> Task:
    """Create the task called `name`. A user's task is guarded (`stages.simulation.guard`).

    Args:
        name: A built-in task; `dm:DOMAIN-TASK`; the name of an entry point in the group `ifo.tasks`; or
            `MODULE:ATTR`, a subclass of Task or a function that returns a task.
        typed: Whether the user typed the name. A `MODULE:ATTR` that comes from a file is imported only if the
            environment variable IFO_TASKS lists it: opening an untrusted file must not run code.

    Raises:
        UsageError: The task does not exist, may not be imported, or (TaskError) is broken.
    """
    if task := _built_in(name):
        return task
    task = guarded(_brought(name, typed))
    for error in attribute_faults(task):
        raise error
    task.defaults = checked_defaults(task.defaults)
    return task


def unguarded_task(name: str, typed: bool = False) -> Task:
    """Create a task as `make_task` does, but without guard and checks."""
    return _built_in(name) or _brought(name, typed)


def _built_in(name: str) -> Task | None:
    """The built-in task called `name`; None if there is none."""
    if (ours := entry(name)) is None:
        return None
    module, _, attribute = ours.where.partition(":")
    made: Callable[..., Task] = getattr(importlib.import_module(module), attribute)
    return made(name) if ours.name.endswith(":") else made()


def _brought(name: str, typed: bool) -> Task:
    """Create a task that is defined in a user's code.

    Raises:
        UsageError: The code cannot be imported, or does not return a task.
    """
    plugin = plugins().get(check_task_name(name))
    if not plugin and not typed and not is_trusted(name):
        raise UsageError(
            f"the file names task {name!r}, which is code outside ifo and is imported only with your permission: "
            f"if you trust it, export {TRUSTED}={name}"
        )
    load: Callable[[], object] = plugin.load if plugin else lambda: _attribute(name)
    module = plugin.module if plugin else name.partition(":")[0]
    made: object = None
    try:
        made = load()
        task = made() if callable(made) else made
    except IfoError:
        raise
    except (Exception, SystemExit) as error:  # User code may fail in any way; none is a bug in ifo.
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] == module.partition(".")[0]:
            raise UsageError(f"task {name!r}: {error}; is its module installed or on PYTHONPATH?") from error
        place = definition(made) if isinstance(made, type) else ""
        raise UsageError(f"task {name!r} cannot be created {failure(error, [module], place)}; fix its code") from error
    if not isinstance(task, Task):
        raise UsageError(f"task {name!r} is a {type(task).__name__}, expected an ifo.Task")
    task.name = name  # Later stages find the task by this name.
    return task


def _attribute(name: str) -> object:
    module, _, attribute = name.partition(":")
    if not module.strip(".") or module.startswith(".") or not attribute:
        raise UsageError(f"task {name!r}: expected MODULE:ATTR, for example my_tasks:Lift")
    made = getattr(importlib.import_module(module), attribute, None)
    if made is None:
        raise UsageError(f"task {name!r}: the module {module} has no {attribute}; is it the right one?")
    return made


def code_digest(task: Task) -> dict[str, str]:
    """The SHA-256 of a user's task file, as `{"task_code": ...}`, so that a changed task makes new artifacts.

    Empty for built-in tasks, whose code is identified by the version of ifo.
    """
    files = [getattr(sys.modules.get(name), "__file__", None) for name in sorted(modules_of(task.__class__))]
    digests = [sha256_of(file) for file in files if file and Path(file).is_file()]
    return {"task_code": " ".join(digests)} if digests else {}


def task_defaults(name: str, typed: bool = False) -> TaskDefaults:
    """The own defaults of the task called `name`, where they differ from the presets.

    Nothing is imported for built-in tasks. Users' tasks are created as by `make_task`.

    Raises:
        UsageError: The task does not exist, may not be imported, or is broken.
    """
    if not name or entry(name) is not None:
        return own_defaults(name)
    choose_backend(required=False)  # The task may import mujoco, which fixes its backend on import.
    return make_task(name, typed).defaults


def known_defaults(name: str) -> TaskDefaults:
    """`task_defaults` of a task that a file names; empty if the task may not be imported."""
    return task_defaults(name) if is_trusted(name) else {}


def file_name(task_name: str) -> str:
    """The task's name as part of a file name."""
    return task_name.replace(":", "-").replace("/", "-")


def distribution(name: str, vary: str = "") -> ContextDistribution:
    """The context distribution called `name`.

    Args:
        vary: Comma-separated factors to vary instead of the task's default factors; empty for the default factors.

    Raises:
        UsageError: The distribution or a factor is unknown.
    """
    if name not in DISTRIBUTIONS:
        raise UsageError(f"--contexts {name!r}: expected one of {', '.join(DISTRIBUTIONS)}")
    factors = parse_factors(vary)
    return DISTRIBUTIONS[name] if factors is None else dataclasses.replace(DISTRIBUTIONS[name], vary=factors)


def learner_context(task: Task, context_seed: int, drawn_from: ContextDistribution) -> Contexts:
    """The learner's context omega_l (leading axis 1), from a random stream that no demonstration uses."""
    return task.draw_contexts(generator(context_seed, "learner-context"), 1, drawn_from)
