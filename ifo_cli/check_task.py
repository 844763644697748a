"""`ifo check-task`: check that a task meets every requirement of the stages."""

from __future__ import annotations

import json
import os
from pathlib import Path

import typer

from artifacts.errors import UsageError
from ifo_cli.options import Given, TaskArgument, stage_command
from ifo_cli.runner import make_folder
from ifo_cli.settling import read_file, settle
from ifo_cli.streams import emit, emit_path, stdout_to_stderr
from stages.config.task_names import check_task_name
from stages.runtime.terminal import say

EXAMPLES = (
    "ifo check-task my_tasks:Lift",
    "ifo check-task push --json",
)
BROKEN = UsageError.exit_code


@stage_command("check-task")
def check_task(task: TaskArgument, given: Given) -> None:
    """Check a task against every requirement of the stages, and render the first frames of 20 contexts.

    Each violation is reported in one line on standard error, with its location. The exit code is 2 if there are any.
    The contact sheet is always written again; an older one is replaced.
    """
    settle(given, read_file(given))  # Refuses options that make no sense.
    check_task_name(task)
    seed, out = given.get("seed"), given.get("out")
    if out is not None and (out.suffix != ".png" or os.path.isdir(out)):
        raise UsageError(f"--out {out}: expected a file name ending in .png")
    with stdout_to_stderr():
        from artifacts import contact_sheet, write_png
        from stages.simulation.gl import choose_backend

        choose_backend()
        from stages.simulation.checking import check_task
        from stages.simulation.probe import SHOWN
        from stages.simulation.registry import file_name, unguarded_task

        report = check_task(unguarded_task(task, typed=True), seed)
        sheet = None
        if report.frames is not None:
            sheet = out or Path("runs") / f"{file_name(task)}.check.png"
            make_folder(sheet)
            write_png(sheet, contact_sheet(report.frames[:, None], n=SHOWN, moments=1))
    for problem in report.problems:
        say(f"ifo: task {task}: {problem}")
    if given.get("json"):
        kept = {"promises": list(report.promises), "problems": list(report.problems)}
        emit(json.dumps({"path": sheet and str(sheet), "kind": "check", "task": task, **kept}))
    elif sheet and not report.problems:
        emit_path(sheet)
    elif sheet:
        say(f"contact sheet: {sheet}")
    if report.problems:
        raise typer.Exit(BROKEN)
