"""Command-line options made from configuration classes, so that each default and help text is written once."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer

from artifacts.errors import PlatformError
from ifo_cli.completion import complete_list
from stages.config.commands import COMMANDS
from stages.config.inventory import RUNS
from stages.config.presets import DEFAULT_PRESET, PRESETS
from stages.config.stages import TASKS
from stages.config.task_names import known_tasks
from stages.reproduction.plan import METHODS

HELP_PRESET = DEFAULT_PRESET
PRESET_NOTE = (
    f"The preset sets the options that you do not give (--preset; default: the parent's, else {HELP_PRESET}). "
    f"Defaults in parentheses are those of preset {HELP_PRESET} for reach; some tasks have their own (--show-config)."
)
METAVARS = {int: "INT", float: "FLOAT", str: "TEXT", Path: "PATH"}
STAGE_PANEL = "Options of this stage"
Function = Callable[..., None]


def complete_task(incomplete: str) -> list[str]:
    """Return the names of tasks that complete a word, for shell completion."""
    return [task for task in known_tasks() if task.startswith(incomplete)]


COMPLETIONS = {
    "task": complete_task,
    "tasks": complete_list(TASKS),
    "methods": complete_list(tuple(METHODS)),
}
TaskArgument = Annotated[
    str,
    typer.Argument(
        help=f"Task: {', '.join(known_tasks())}, dm:DOMAIN-TASK, or MODULE:ATTR.",
        autocompletion=complete_task,
        show_default=False,
    ),
]
FoldersArgument = Annotated[
    list[Path] | None,
    typer.Argument(readable=False, help=f"Folders to search (default: {RUNS}).", show_default=False),
]


@dataclass(frozen=True)
class Given:
    """The parsed command line.

    Attributes:
        command: Name of the command.
        config: Fields of the command's configuration that were given.
        shared: Options shared with other commands that were given.
        words: The words of the command line after `ifo`.
    """

    command: str
    config: dict[str, Any]
    shared: dict[str, Any]
    words: list[str]

    def get(self, name: str) -> Any:
        """Return the value of a shared option, given or default."""
        return self.shared.get(name, getattr(COMMANDS[self.command].shared(), name))


def shown_default(value: Any) -> str:
    """Return a default as the help text shows it; empty if there is nothing to show."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _parameters(config_class: type, defaults: Any, names: tuple[str, ...], panel: str) -> Iterator[inspect.Parameter]:
    """Yield a typer option for each of the named fields; an option that is not given is None, whatever its default.

    Args:
        config_class: The class that has the fields.
        defaults: An instance whose values the help texts show; None: show only the defaults of fields with `show`.
        names: Names of the fields.
        panel: Heading of the options in the help text; empty: the common heading.
    """
    types = get_type_hints(config_class)
    items = {item.name: item for item in dataclasses.fields(config_class)}
    for name in names:
        item = items[name]
        settings: dict[str, Any] = {"rich_help_panel": panel} if panel else {}
        annotation = next((kind for kind in get_args(types[name]) if isinstance(kind, type)), types[name])
        about = item.metadata
        choices = about["choices"]
        flag = annotation is bool and len(about.get("names", ())) > 0
        if get_origin(types[name]) is tuple:
            # Typer does not accept a list of literals, but it accepts a list of an enumeration.
            element = StrEnum(name, {choice: choice for choice in choices}) if choices else str
            annotation = list[element]  # type: ignore[valid-type]
            settings["metavar"] = "|".join(choices) or "TEXT"
        elif choices:
            annotation = Literal[tuple(choices)]
        elif annotation is not bool:
            settings["metavar"] = about.get("metavar", METAVARS[annotation])
        if "metavar" in settings and (bounds := _bounds(about["low"], about["high"])):
            settings["metavar"] += f" [{bounds}]"  # The configuration class checks them, as for files of options.
        if annotation is Path:
            settings["readable"] = False  # Whoever opens the file says why it cannot be read.
        if completion := COMPLETIONS.get(about.get("complete", "")):
            settings["autocompletion"] = completion
        source = defaults if defaults is not None else item.default if about.get("show") else None
        shown = shown_default(source if defaults is None else getattr(defaults, name))
        text = about["help"] + (f" ({shown})" if shown else "")
        option = typer.Option(*about.get("names", ()), help=text, show_default=False, **settings)
        yield _keyword(name, Annotated[annotation, option], False if flag else None)


def stage_command(name: str) -> Callable[[Function], Function]:
    """Give a command the options of its configuration classes; the command receives them as its argument `given`.

    Args:
        name: Name of the command in `stages.config.commands.COMMANDS`.
    """
    command = COMMANDS[name]
    own = tuple(item.name for item in dataclasses.fields(command.config))

    def decorate(function: Function) -> Function:
        arguments = [
            parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
            for parameter in inspect.signature(function, eval_str=True).parameters.values()
            if parameter.name != "given"
        ]
        shared_panel = STAGE_PANEL if own else ""
        parameters = [
            _keyword("context", typer.Context, inspect.Parameter.empty),
            *arguments,
            *_parameters(command.shared, None, command.names, ""),
            *_parameters(command.config, PRESETS[HELP_PRESET].get(name, command.config()), own, shared_panel),
        ]

        @functools.wraps(function)
        def wrapper(**values: Any) -> None:
            try:
                os.getcwd()
            except OSError as error:
                raise PlatformError(f"the working folder is gone ({error.strerror}): change to another one") from error
            given = Given(
                name,
                config={key: _plain(values[key]) for key in own if values[key] is not None},
                shared={key: values[key] for key in command.names if _is_given(values[key])},
                words=list(values["context"].find_root().obj or []),
            )
            function(**{argument.name: values[argument.name] for argument in arguments}, given=given)

        wrapper.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        wrapper.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        return wrapper

    return decorate


def _is_given(value: Any) -> bool:
    return value is not None and value is not False


def _bounds(low: float | None, high: float | None) -> str:
    if low is None:
        return ""
    return f"x>={low:g}" if high is None else f"{low:g}<=x<={high:g}"


def _plain(value: Any) -> Any:
    return tuple(map(str, value)) if isinstance(value, list) else value


def _keyword(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
