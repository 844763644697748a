"""`ifo view`: show one artifact on one page."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from artifacts.errors import UsageError
from ifo_cli.options import Given, stage_command
from ifo_cli.runner import emit_result
from ifo_cli.settling import read_file, settle
from ifo_cli.streams import inputs_or_stdin, stdout_to_stderr
from stages.runtime.terminal import say

EXAMPLES = (
    "ifo view runs/reach-c0.translation.h5 --open",
    "ifo evaluate runs/reach-c0.policy.h5 | ifo view",
)


@stage_command("view")
def view(
    given: Given,
    file: Annotated[
        Path | None, typer.Argument(readable=False, help="Artifact (default: the path on standard input).")
    ] = None,
) -> None:
    """Show an artifact of any kind on one page: key figures, curves, pictures, videos, configuration and lineage.

    The page is a single HTML file that contains all that it shows. It can be sent to others: it contains no script
    and no absolute path. A page of an earlier `ifo view` is replaced.
    """
    settle(given, read_file(given))  # Refuses options that make no sense.
    out = given.get("out")
    if out is not None and (out.suffix != ".html" or os.path.isdir(out)):
        raise UsageError(f"--out {out}: expected a file name ending in .html")
    path = inputs_or_stdin([file] if file else [], "the artifact to view")[0]
    with stdout_to_stderr():
        from stages.runtime.progress import Progress
        from stages.view import view

        result = view(path, out, Progress(quiet=given.get("quiet")))
    emit_result(given, result, "page")
    if given.get("open"):
        with stdout_to_stderr():
            _open(result.path)


def _open(page: Path) -> None:
    import webbrowser

    if not webbrowser.open(page.resolve().as_uri()):
        say(f"no browser could be started: open {page} yourself")
