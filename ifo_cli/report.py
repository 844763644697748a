"""`ifo report`: show the results of evaluations on one page."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from artifacts.errors import UsageError
from ifo_cli.options import Given, stage_command
from ifo_cli.runner import command_line, emit_result, settled_alone
from ifo_cli.streams import inputs_or_stdin, stdout_to_stderr

EXAMPLES = (
    "ifo report runs",
    "ifo report runs/reach-c0.evaluation.h5 runs/push-c0.evaluation.h5 --out runs/both.html --title 'Reach and push'",
)


@stage_command("report")
def report(
    given: Given,
    runs: Annotated[
        list[Path] | None,
        typer.Argument(
            readable=False,
            help="Evaluations, or folders to search for them (default: paths on standard input).",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Show evaluations on one page: success by task and method, learning curves, videos, and the origin of each number.

    The page is a single HTML file. Files with the same stem next to it hold the runs (.csv), the table (.md) and the
    plots (.png).
    """
    settled = settled_alone(given)
    if settled is None:
        return
    out = given.get("out")
    if out.suffix != ".html":
        raise UsageError(f"--out {out}: expected a file name ending in .html")
    if os.path.isdir(out):
        raise UsageError(f"--out {out} is a folder: expected a file name ending in .html")
    paths = inputs_or_stdin(runs or [], "the evaluation artifacts (NAME.evaluation.h5) or their folder", several=True)
    with stdout_to_stderr():
        from stages.report import report
        from stages.runtime.progress import Progress

        command = command_line(given, () if runs else paths)
        result = report(paths, out, settled.config.title, command, Progress(quiet=given.get("quiet")))
    emit_result(given, result, "report")
