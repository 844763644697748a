"""The stages of the pipeline as Python functions. Import them from `ifo`, which re-exports them.

A stage is a function with the name of its command, and an option is a keyword argument with the name of the option:
`ifo.train_translator(demos, steps=3000, evaluate_every=250)` is `ifo train-translator DEMOS --steps 3000
--evaluate-every 250`, writes the same file and records that command line. `--from`, a keyword of Python, is `base`;
`--no-amp` is `amp=False`. pipeline.pyi has the types of all options.

Each function returns a `StageResult`, which later functions accept in place of a path.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from artifacts.errors import UsageError
from stages.runtime.run import StageResult

if TYPE_CHECKING:
    from os import PathLike

    from typer.core import TyperCommand

# Options of the commands that make no sense from Python, or that the functions themselves give.
NOT_HERE = ("config", "help", "json", "show_config", "show_help")


def train_expert(task: str, **options: Any) -> StageResult:
    """Train the expert that demonstrates a task, as `ifo train-expert` does."""
    return _run("train-expert", [task], options)


def collect_demos(task: str, **options: Any) -> StageResult:
    """Record a demonstrator in many contexts, as `ifo collect-demos` does."""
    return _run("collect-demos", [task], options)


def import_demos(videos: str | PathLike[str] | Sequence[str | PathLike[str]], **options: Any) -> StageResult:
    """Turn videos, folders of videos or data sets into demonstrations, as `ifo import-demos` does."""
    return _run("import-demos", _several(videos), options)


def train_translator(demos: str | PathLike[str], **options: Any) -> StageResult:
    """Train the network that translates a video between contexts, as `ifo train-translator` does."""
    return _run("train-translator", [demos], options)


def translate(translator: str | PathLike[str], **options: Any) -> StageResult:
    """Translate demonstrations into the learner's context, as `ifo translate` does."""
    return _run("translate", [translator], options)


def learn_policy(translation: str | PathLike[str], **options: Any) -> StageResult:
    """Learn a policy that tracks translated demonstrations, as `ifo learn-policy` does."""
    return _run("learn-policy", [translation], options)


def evaluate(policies: str | PathLike[str] | Sequence[str | PathLike[str]], **options: Any) -> StageResult:
    """Run policies and measure how well they do the task, as `ifo evaluate` does."""
    return _run("evaluate", _several(policies), options)


STAGES = (train_expert, collect_demos, import_demos, train_translator, translate, learn_policy, evaluate)


def parameters(command: TyperCommand) -> dict[str, Any]:
    """Return the options of a command that its function accepts, by their names in Python."""
    return {
        str(parameter.name): parameter
        for parameter in command.params
        if parameter.param_type_name == "option" and parameter.name not in NOT_HERE
    }


def command_of(name: str) -> TyperCommand:
    """Return the command called `name`."""
    import typer.main

    from ifo_cli.main import app

    group: Any = typer.main.get_command(app)
    return group.commands[name]


def _several(paths: str | PathLike[str] | Iterable[str | PathLike[str]]) -> list[str | PathLike[str]]:
    return [paths] if isinstance(paths, str | os.PathLike) else list(paths)


def _run(name: str, inputs: Sequence[str | PathLike[str]], options: dict[str, Any]) -> StageResult:
    """Run a command in this process.

    Raises:
        IfoError: What the command would print; see `ifo.UsageError`, `ifo.ArtifactError` and `ifo.PlatformError`.
        TypeError: The command has no such option.
    """
    import typer

    from ifo_cli.main import run_words

    if not inputs:
        raise UsageError(f"{name}: no input")
    paths = [os.path.join(".", path) if path.startswith("-") else path for path in map(os.fspath, inputs)]
    words = [name, *paths, *_words(name, options)]
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), _script_not_imported():
            run_words(words, "--json")
    except typer.TyperException as error:
        raise UsageError(error.format_message()) from error
    figures = json.loads(printed.getvalue())
    figures.pop("kind", None)
    return StageResult(Path(figures.pop("path")), figures)


def _words(name: str, options: dict[str, Any]) -> list[str]:
    """Return options as words of a command line; options that are None are left out."""
    known = parameters(command_of(name))
    words: list[str] = []
    for option, value in options.items():
        if option not in known:
            raise TypeError(f"{name.replace('-', '_')}() has no option {option!r}")
        if value is None:
            continue
        yes, no = known[option].opts[-1], known[option].secondary_opts
        if isinstance(value, bool) and known[option].is_flag:
            words += [yes] if value else no[-1:]
        else:
            values = value if known[option].multiple and not isinstance(value, str) else [value]
            words += [f"{yes}={os.fspath(item) if isinstance(item, os.PathLike) else item}" for item in values]
    return words


@contextlib.contextmanager
def _script_not_imported() -> Iterator[None]:
    """Keep processes that start in the block from importing the script that called us.

    They do not need it. Without `if __name__ == "__main__"` in the script, they would run the pipeline again.
    """
    main = sys.modules["__main__"]
    kept = {name: vars(main).pop(name) for name in ("__file__", "__spec__") if name in vars(main)}
    main.__spec__ = None
    try:
        yield
    finally:
        del main.__spec__
        vars(main).update(kept)
