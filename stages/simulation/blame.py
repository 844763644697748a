"""One-line errors about a user's own task, with the location in the user's file."""

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
    """A user's task violates the interface `stages.simulation.task.Task`.

    Attributes:
        problem: The fault and its location, without the task's name.
    """

    def __init__(self, name: str, problem: str):
        self.problem = problem
        super().__init__(f"task {name}: {problem}; check the whole task with: ifo check-task {name}")


def broken(task: Task, member: str, problem: str) -> TaskError:
    """The error for a method or attribute of `task` that violates the interface, with the place of its definition."""
    place = definition(task.__class__, member)  # A guard reports the class of the guarded task, but has another type.
    return TaskError(task.name, f"{member}{f' ({place})' if place else ''} {problem}")


def failure(error: BaseException, modules: Iterable[str], otherwise: str = "") -> str:
    """Format an exception of the code in `modules` in one line: `at glide.py:57 (KeyError: 'gaol')`.

    Args:
        modules: Names of the user's modules.
        otherwise: The location to report if the traceback contains none of the user's lines.
    """
    if isinstance(error, SyntaxError) and error.filename:
        place = _shown(error.filename, error.lineno or 0)
    else:
        place = _line_of(error.__traceback__, modules) or otherwise
    reason = " ".join(f"{type(error).__name__}: {_message(error)}".split())
    return f"at {place} ({reason})" if place else f"({reason})"


def definition(kind: type, *names: str) -> str:
    """Location, like `glide.py:55`, of the first of `names` that a user's class defines, else of the class itself.

    Empty if the class consists only of ifo's own code.
    """
    theirs = [cls for cls in kind.__mro__ if not _is_ours(cls)]
    for name in names:
        for cls in theirs:
            if found := _code_place(vars(cls).get(name)):
                return found
    for cls in theirs:
        try:
            return _shown(inspect.getsourcefile(cls) or "", inspect.findsource(cls)[1] + 1)
        except (OSError, TypeError):  # Defined without a file, as in an interactive session.
            continue
    return ""


def modules_of(kind: type) -> set[str]:
    """Names of the modules that define a user's class and its bases."""
    return {cls.__module__ for cls in kind.__mro__ if not _is_ours(cls)}


def _message(error: BaseException) -> object:
    """The message of an exception. For a SyntaxError the location is omitted, because it is reported separately."""
    return error.msg if isinstance(error, SyntaxError) else error


def _line_of(traceback: TracebackType | None, modules: Iterable[str]) -> str:
    """Location of the innermost line of the user's own code; empty if there is none."""
    homes = [home for name in modules if (home := _home(name))]
    place = ""
    while traceback is not None:
        filename = traceback.tb_frame.f_code.co_filename
        if _is_theirs(filename, homes):
            place = _shown(filename, traceback.tb_lineno)
        traceback = traceback.tb_next
    return place


def _home(module: str) -> Path | None:
    """The folder of a module's top-level package, or the file of a top-level module."""
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
    """Location of a method or property of a class; empty if it is neither."""
    for attribute in ("fget", "func", "__func__"):  # property, cached property, static or class method
        member = getattr(member, attribute, member)
    code = getattr(inspect.unwrap(member) if callable(member) else member, "__code__", None)
    return _shown(code.co_filename, code.co_firstlineno) if code else ""


def _shown(filename: str, line: int) -> str:
    """`FILE:LINE`, relative to the working folder if the file is inside it."""
    path, here = Path(filename).resolve(), Path.cwd()
    return f"{path.relative_to(here) if path.is_relative_to(here) else path}:{line}"
