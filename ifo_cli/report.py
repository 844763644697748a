"""`ifo report`: what evaluations come to, on one page."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated

import typer

from artifacts.errors import UsageError
from ifo_cli.streams import emit, inputs_or_stdin, plain, stdout_to_stderr

EXAMPLES = (
    "ifo report runs",
    "ifo report runs/reach-c0.evaluation.h5 runs/push-c0.evaluation.h5 --out runs/both.html --title 'Reach and push'",
)
TITLE = "Imitation from observation"


def report(
    context: typer.Context,
    runs: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Evaluations, or folders to search for them (default: paths on standard input).", show_default=False
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Page to write, ending in .html.", metavar="PATH")] = Path(
        "runs/report.html"
    ),
    title: Annotated[str, typer.Option(help="The page's heading.", metavar="TEXT")] = TITLE,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object with the page's figures.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No messages on standard error.")] = False,
) -> None:
    """Put evaluations on one page: success by task and method, learning curves, videos, and where numbers come from.

    The page is one file that any browser opens. Beside it, with its stem, lie the runs as .csv, the table as .md,
    and the plots as .png.
    """
    if out.suffix != ".html":
        raise UsageError(f"--out {out}: expected a file name ending in .html")
    if out.is_dir():
        raise UsageError(f"--out {out} is a folder: expected a file name ending in .html")
    paths = inputs_or_stdin(runs or [], "the evaluation artifacts (NAME.evaluation.h5), or their folder", several=True)
    words = [*(context.find_root().obj or []), *(() if runs else map(str, paths))]
    with stdout_to_stderr():
        from stages.report import report
        from stages.runtime.progress import Progress

        result = report(paths, out, title, shlex.join(["ifo", *words]), Progress(quiet=quiet))
    if as_json:
        emit(json.dumps({"path": str(result.path), "kind": "report", **plain(result.summary)}))
    else:
        emit(str(result.path))
