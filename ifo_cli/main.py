"""The `ifo` command. Heavy packages are imported only when a command runs."""

from __future__ import annotations

import os
import re
import shlex
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from inspect import cleandoc
from typing import Annotated, Any

import typer
import typer.main

from artifacts.errors import IfoError
from ifo_cli import (
    check_task,
    collect_demos,
    doctor,
    evaluate,
    export_demos,
    gc,
    import_demos,
    inspect,
    learn_policy,
    ls,
    report,
    reproduce,
    train_expert,
    train_translator,
    translate,
    verify,
    view,
)
from ifo_cli.options import PRESET_NOTE
from ifo_cli.streams import standard_streams
from stages.runtime.interrupts import killable, undisguised_interrupts
from stages.runtime.terminal import say

INTERRUPTED = 130
BUG = 1

# Wording of the library that checks values -> our wording.
REWORDED = {
    "Value error, ": "",
    "Input should be greater": "expected a value greater",
    "Input should be": "expected",
}

EXAMPLE_WIDTH = 76  # columns; not wrapped in a terminal of 80, so that examples can be copied into a shell


def copyable(command: str) -> str:
    """Split a command into lines that are short enough not to be wrapped, with the shell's line continuation."""
    lines = [""]
    for part in re.split(r" (?=[|-])", command):  # before an option, or the next command of a pipe
        if lines[-1] and len(lines[-1]) + len(part) + 3 > EXAMPLE_WIDTH:
            lines[-1] += " \\"
            lines.append(f"    {part}")
        else:
            lines[-1] = f"{lines[-1]} {part}".lstrip()
    return "\n".join(lines)


PIPELINE = "ifo collect-demos reach | ifo train-translator | ifo translate | ifo learn-policy | ifo evaluate"

app = typer.Typer(
    name="ifo",
    rich_markup_mode="rich",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=f"Example:\n\n{copyable(PIPELINE)}",
)


def _register(name: str, function: Callable[..., Any], examples: Sequence[str], note: str = "") -> None:
    heading = "Example" if len(examples) == 1 else "Examples"
    paragraphs = [f"{heading}:", "\n".join(copyable(example) for example in examples)]
    epilog = "\n\n".join([note, *paragraphs] if note else paragraphs)
    app.command(name, help=_flowing(function), epilog=epilog)(function)


def _flowing(function: Callable[..., Any]) -> str:
    """Return a docstring with each paragraph on one line, so that it wraps only where the terminal ends."""
    return "\n\n".join(" ".join(lines.split()) for lines in cleandoc(function.__doc__ or "").split("\n\n"))


_register("train-expert", train_expert.train_expert, train_expert.EXAMPLES, PRESET_NOTE)
_register("collect-demos", collect_demos.collect_demos, collect_demos.EXAMPLES, PRESET_NOTE)
_register("import-demos", import_demos.import_demos, import_demos.EXAMPLES)
_register("export-demos", export_demos.export_demos, export_demos.EXAMPLES)
_register("train-translator", train_translator.train_translator, train_translator.EXAMPLES, PRESET_NOTE)
_register("translate", translate.translate, translate.EXAMPLES, PRESET_NOTE)
_register("learn-policy", learn_policy.learn_policy, learn_policy.EXAMPLES, PRESET_NOTE)
_register("evaluate", evaluate.evaluate, evaluate.EXAMPLES, PRESET_NOTE)
_register("reproduce", reproduce.reproduce, reproduce.EXAMPLES, reproduce.NOTE)
_register("report", report.report, report.EXAMPLES)
_register("view", view.view, view.EXAMPLES)
_register("ls", ls.ls, ls.EXAMPLES)
_register("gc", gc.gc, gc.EXAMPLES, gc.NOTE)
_register("inspect", inspect.inspect, inspect.EXAMPLES)
_register("verify", verify.verify, verify.EXAMPLES)
_register("check-task", check_task.check_task, check_task.EXAMPLES)
_register("doctor", doctor.doctor, doctor.EXAMPLES)


def _version(wanted: bool) -> None:
    if wanted:
        from artifacts.version import ifo_version

        print(f"ifo {ifo_version()}")
        raise typer.Exit


@app.callback()
def _ifo(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Learn to do what videos show: imitation from observation via context translation.

    Each command reads one versioned file, writes the next, and prints only its path: commands can be piped together.
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    # Processes launched together may be blocked waiting for each other; only the default handler ends them then.
    with standard_streams(), nullcontext() if "WORLD_SIZE" in os.environ else killable():
        return _run(words)


def run_words(words: list[str], *unrecorded: str) -> Any:
    """Run a command line in this process, without handling errors and signals; returns what the command returns.

    Args:
        words: The words after `ifo`, which artifacts record.
        unrecorded: Further words, which they do not record.
    """
    # OpenMP threads that spin while they wait make everything ten times slower as soon as another process, such as a
    # render process, needs their core. torch reads this variable when it is imported, so it is set here.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    command = typer.main.get_command(app)
    with undisguised_interrupts():
        return command.main([*words, *unrecorded], prog_name="ifo", standalone_mode=False, obj=words)


def _run(words: list[str]) -> int:
    try:
        code = run_words(words)
        sys.stdout.flush()
    except typer.TyperException as error:
        from stages.runtime.processes import is_main

        if not is_main():
            return 0  # All processes got the same command line, and the main process reports what is wrong with it.
        message = _tidied(error.format_message())
        if message and words:
            help_command = shlex.join(["ifo", *_command_of(words), "--help"])
            say(f"ifo: {message.rstrip('.')} (see {help_command})")
        return error.exit_code
    except IfoError as error:
        say(f"ifo: {error}")
        return error.exit_code
    except KeyboardInterrupt:
        code = INTERRUPTED
    except Exception:
        traceback.print_exc()
        say("ifo: this is a bug in ifo: please report it, with the lines above and the command")
        return BUG
    if code == INTERRUPTED:
        say("ifo: interrupted")
    return code if isinstance(code, int) else 0


def _tidied(message: str) -> str:
    """Return the message of a usage error as one line, in our wording."""
    for theirs, ours in REWORDED.items():
        message = message.replace(theirs, ours)
    return " ".join(message.split())


def _command_of(words: list[str]) -> list[str]:
    names = {command.name for command in app.registered_commands}
    return [words[0]] if words[0] in names else []


if __name__ == "__main__":
    sys.exit(main())
