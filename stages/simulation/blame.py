"""Errors of a user's own task, told in one line that names the place in the user's file."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable
from importlib import util
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from artifacts.errors import UsageError

if TYPE_CHECKING:
    from stages.simulation.task import Task

ROOT = Path(__file__).resolve().parents[2]
OURS = tuple(ROOT / package for package in ("artifacts", "ifo", "ifo_cli", "stages"))
INSTALLED = {"site-packages", "dist-packages"}
STANDARD_LIBRARY = Path(inspect.__file__).resolve().parent


class TaskError(UsageError):
    """A user's task does not do what `stages.simulation.task.Task` promises.

    Attributes:
        problem: What is wrong and where, without the task's name.
    """

    def __init__(self, name: str, problem: str):
        self.problem = problem
        super().__init__(f"task {name}: {problem}; check the whole task with: ifo check-task {name}")


def broken(task: Task, member: str, problem: str) -> TaskError:
    """The error that a method or attribute of `task` breaks its promise, with the place of its definition."""
    place = definition(task.__class__, member)  # A guard has the class of what it guards, but another type.
    return TaskError(task.name, f"{member}{f' ({place})' if place else ''} {problem}")


def failure(error: BaseException, modules: Iterable[str], otherwise: str = "") -> str:
    """`at glide.py:57 (KeyError: 'gaol')`: an exception of the code in `modules` in one line.

    Args:
        modules: Names of the user's modules.
        otherwise: The place where the traceback shows none of the user's lines.
    """
    if isinstance(error, SyntaxError) and error.filename:
        place = _shown(error.filename, error.lineno or 0)
    else:
        place = _line_of(error.__traceback__, modules) or otherwise
    reason = " ".join(f"{type(error).__name__}: {_message(error)}".split())
    return f"at {place} ({reason})" if place else f"({reason})"


def definition(kind: type, *names: str) -> str:
    """`glide.py:55`: where a user's class defines the first of `names` that it defines, else the class itself.

    Empty where all of it is ifo's.
    """
    theirs = [cls for cls in kind.__mro__ if not _is_ours(cls)]
    for name in names:
        for cls in theirs:
            if found := _code_place(vars(cls).get(name)):
                return found
    for cls in theirs:
        try:
            return _shown(inspect.getsourcefile(cls) or "", inspect.findsource(cls)[1] + 1)
        except (OSError, TypeError):  # Made without a file, as in an interactive session.
            continue
    return ""


def modules_of(kind: type) -> set[str]:
    """Names of the modules that define a user's class."""
    return {cls.__module__ for cls in kind.__mro__ if not _is_ours(cls)}


def _message(error: BaseException) -> object:
    """The message of an exception; of a SyntaxError without the place, which is told once."""
    return error.msg if isinstance(error, SyntaxError) else error


def _line_of(traceback: TracebackType | None, modules: Iterable[str]) -> str:
    """The innermost line of the user's own code; empty if there is none."""
    homes = [home for name in modules if (home := _home(name))]
    place = ""
    while traceback is not None:
        filename = traceback.tb_frame.f_code.co_filename
        if _is_theirs(filename, homes):
            place = _shown(filename, traceback.tb_lineno)
        traceback = traceback.tb_next
    return place


def _home(module: str) -> Path | None:
    """The folder of a module's top-level package, or the file of a module that is in none."""
    top = module.partition(".")[0]
    try:
        spec = getattr(sys.modules.get(top), "__spec__", None) or util.find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None or not spec.origin:
        return None
    origin = Path(spec.origin).resolve()
    return origin.parent if spec.submodule_search_locations else origin


def _is_theirs(filename: str, homes: list[Path]) -> bool:
    if filename.startswith("<"):
        return False
    path = Path(filename).resolve()
    if any(path.is_relative_to(folder) for folder in OURS):
        return False
    if any(path.is_relative_to(home) for home in homes):
        return True
    return not INSTALLED.intersection(path.parts) and not path.is_relative_to(STANDARD_LIBRARY)


def _is_ours(cls: type) -> bool:
    return cls.__module__.partition(".")[0] in ("abc", "builtins", *(package.name for package in OURS))


def _code_place(member: object) -> str:
    """Where a method or a property of a class stands; empty if it is neither."""
    for attribute in ("fget", "func", "__func__"):  # of a property, a cached property, a static or class method
        member = getattr(member, attribute, member)
    code = getattr(inspect.unwrap(member) if callable(member) else member, "__code__", None)
    return _shown(code.co_filename, code.co_firstlineno) if code else ""


def _shown(filename: str, line: int) -> str:
    """`FILE:LINE`, relative to the working folder where the file lies below it."""
    path, here = Path(filename).resolve(), Path.cwd()
    return f"{path.relative_to(here) if path.is_relative_to(here) else path}:{line}"
