"""Command-line options made from a stage's configuration class, so that a default is written once."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer

from stages.config.presets import DEFAULT_PRESET, PRESETS
from stages.config.stages import STAGES
from stages.config.task_names import known_tasks

HELP_PRESET = DEFAULT_PRESET
PRESET_NOTE = (
    f"What an option leaves open comes from --preset: the parent's, else {HELP_PRESET}. "
    f"Defaults in brackets are those of {HELP_PRESET} for reach; some tasks have their own."
)
Command = Callable[..., None]

NUMBER = {int: "INT", float: "FLOAT"}
STAGE_PANEL = "Options of this stage"


def complete_task(incomplete: str) -> list[str]:
    """Names of tasks, for shell completion."""
    return [task for task in known_tasks() if task.startswith(incomplete)]


TaskArgument = Annotated[
    str,
    typer.Argument(
        help=f"Task: {', '.join(known_tasks())}, dm:DOMAIN-TASK, or MODULE:ATTR.",
        autocompletion=complete_task,
        show_default=False,
    ),
]


@dataclass(frozen=True)
class Given:
    """What the command line said.

    Attributes:
        config: Fields of the stage's configuration that were given.
        run: Fields of `RunOptions` that were given, `preset` and `seed` among them.
        json: Print a JSON object in place of the path.
        quiet: No progress.
        words: The command line's words after `ifo`.
    """

    config: dict[str, Any]
    run: dict[str, Any]
    json: bool
    quiet: bool
    words: list[str]


def _option(annotation: Any, text: str, *names: str, default: Any = None, **settings: Any) -> Any:
    option = typer.Option(*names, help=text, show_default=False, **settings)
    return Annotated[annotation, option], default


COMMON: dict[str, tuple[Any, Any]] = {
    "preset": _option(
        Literal[tuple(PRESETS)],
        f"Defaults of every option: the parent's preset, else {HELP_PRESET}.",
    ),
    "seed": _option(int, "The run's only seed: the parent's, else 0.", min=0, metavar="INT"),
    "device": _option(str, "auto (CUDA where there is one), cpu, cuda or cuda:N.", metavar="DEVICE"),
    "workers": _option(int, "Threads and render processes (0: one a core).", min=0, metavar="INT"),
    "out": _option(Path, "Artifact to write, ending in .h5 (default: runs/NAME.KIND.h5).", metavar="PATH"),
    "resume": _option(bool, "Continue from the checkpoint beside --out.", "--resume", default=False),
    "overwrite": _option(
        bool,
        "Replace a finished artifact at --out (default: keep it if it is the same, else stop).",
        "--overwrite",
        default=False,
    ),
    "json": _option(bool, "Print one JSON object with the stage's figures.", "--json", default=False),
    "quiet": _option(bool, "No progress on standard error.", "--quiet", "-q", default=False),
}


def shown_default(value: Any) -> str:
    """A preset's value as the help text shows it; empty where there is nothing to show."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def config_parameters(stage: str) -> list[inspect.Parameter]:
    """A typer option for every field of the stage's configuration, each defaulting to None: not given."""
    config_class = STAGES[stage]
    types = get_type_hints(config_class)
    parameters = []
    for item in dataclasses.fields(config_class):
        annotation: Any = types[item.name]
        choices = item.metadata.get("choices") or ()
        settings: dict[str, Any] = {"rich_help_panel": STAGE_PANEL}
        if get_origin(annotation) is tuple:
            # Typer takes no list of literals, but a list of an enumeration.
            members = {choice: choice for choice in choices}
            element = StrEnum(item.name, members) if choices else get_args(annotation)[0]
            annotation = list[element]  # type: ignore[valid-type]
            settings["metavar"] = "|".join(choices) or "TEXT"
        elif choices:
            annotation = Literal[tuple(choices)]
        elif annotation in (int, float):
            settings.update(min=item.metadata.get("low"), max=item.metadata.get("high"), metavar=NUMBER[annotation])
        shown = shown_default(getattr(PRESETS[HELP_PRESET][stage], item.name))
        text = item.metadata["help"] + (f" ({shown})" if shown else "")
        names = ("-n", "--n") if item.name == "n" else ()
        annotated, default = _option(annotation, text, *names, **settings)
        parameters.append(_keyword(item.name, annotated, default))
    return parameters


def stage_command(stage: str, *, resume: bool = False) -> Callable[[Command], Command]:
    """Give a command the options of its stage; it receives them as its argument `given`.

    Args:
        stage: Name of the stage in `stages.config.stages.STAGES`.
        resume: Whether the stage keeps checkpoints, so that --resume makes sense.
    """

    def decorate(function: Command) -> Command:
        own = [
            parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
            for parameter in inspect.signature(function, eval_str=True).parameters.values()
            if parameter.name != "given"
        ]
        common = [
            _keyword(name, annotated, default)
            for name, (annotated, default) in COMMON.items()
            if resume or name != "resume"
        ]
        context = _keyword("context", typer.Context, inspect.Parameter.empty)
        parameters = [context, *own, *common, *config_parameters(stage)]

        @functools.wraps(function)
        def command(**values: Any) -> None:
            arguments = {parameter.name: values[parameter.name] for parameter in own}
            function(**arguments, given=_gather(stage, values))

        command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        return command

    return decorate


def _keyword(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)


def _gather(stage: str, values: dict[str, Any]) -> Given:
    config = {}
    for item in dataclasses.fields(STAGES[stage]):
        value = values[item.name]
        if value is not None:
            config[item.name] = tuple(map(str, value)) if isinstance(value, list) else value
    run_names = ("preset", "seed", "device", "workers", "out", "resume", "overwrite")
    run = {name: values[name] for name in run_names if values.get(name) is not None}
    words = values["context"].find_root().obj or []
    return Given(config, run, json=values["json"], quiet=values["quiet"], words=list(words))
