"""`ifo check-task`: does a task keep the promises that every stage relies on?"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from artifacts.errors import UsageError
from ifo_cli.options import TaskArgument
from ifo_cli.runner import make_folder
from ifo_cli.streams import emit, stdout_to_stderr
from stages.config.task_names import check_task_name

EXAMPLES = (
    "ifo check-task my_tasks:Lift",
    "ifo check-task push --json",
)
BROKEN = UsageError.exit_code


def check_task(
    task: TaskArgument,
    seed: Annotated[int, typer.Option(min=0, metavar="INT", help="Seed of everything that is drawn.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Contact sheet to write (default: runs/TASK.check.png).", show_default=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object in place of the path.")] = False,
) -> None:
    """Hold a task to every promise that the stages rely on, and draw the first frames of 20 contexts.

    Each broken promise is one line on standard error that says what is wrong and where. Exit code 2 if there is any.
    The contact sheet is drawn anew each time: an older one is replaced.
    """
    check_task_name(task)
    if out is not None and (out.suffix != ".png" or out.is_dir()):
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
        print(f"ifo: task {task}: {problem}", file=sys.stderr, flush=True)
    if as_json:
        kept = {"promises": list(report.promises), "problems": list(report.problems)}
        emit(json.dumps({"path": sheet and str(sheet), "kind": "check", "task": task, **kept}))
    elif sheet and not report.problems:
        emit(str(sheet))
    elif sheet:
        print(f"contact sheet: {sheet}", file=sys.stderr, flush=True)
    if report.problems:
        raise typer.Exit(BROKEN)
