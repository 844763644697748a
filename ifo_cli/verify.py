"""`ifo verify`: are these files whole, and their parents unchanged?"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from artifacts.errors import ArtifactError
from ifo_cli.streams import emit, inputs_or_stdin

EXAMPLES = (
    "ifo verify runs/*.h5",
    "ifo collect-demos reach --preset toy | ifo verify",
)


def verify(
    files: Annotated[
        list[Path] | None, typer.Argument(help="Artifacts (default: paths on standard input, one a line).")
    ] = None,
) -> None:
    """Read artifacts whole, checking every checksum and that their parents are unchanged.

    Exit code 3 if anything is wrong with any of them.
    """
    from artifacts import verify_artifact

    bad = 0
    for path in inputs_or_stdin(files or [], "the artifacts to verify", several=True):
        try:
            report = verify_artifact(path)
        except ArtifactError as error:
            bad = error.exit_code
            print(f"ifo: {error}", file=sys.stderr, flush=True)
        else:
            counts = f"{_count(report.datasets, 'dataset')}, {_count(report.parents, 'parent')}"
            emit(f"ok {path} ({report.kind}, {counts})")
    if bad:
        raise typer.Exit(bad)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
