"""`ifo verify`: check that files are complete and their parents unchanged."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from artifacts.errors import ArtifactError
from ifo_cli.options import Given, stage_command
from ifo_cli.streams import emit, inputs_or_stdin
from stages.runtime.terminal import say

EXAMPLES = (
    "ifo verify runs",
    "ifo verify runs/reach.demos.h5 runs/reach.translator.h5",
    "ifo collect-demos reach --preset toy | ifo verify",
)


@stage_command("verify")
def verify(
    given: Given,
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            readable=False,
            help="Artifacts, or folders to search for them (default: paths on standard input, one per line).",
        ),
    ] = None,
) -> None:
    """Read artifacts completely, check every checksum, and check that their parents are unchanged.

    In a folder and its subfolders, every file named NAME.KIND.h5 is checked, including checkpoints.
    The exit code is 3 if any file fails a check.
    """
    from artifacts import verify_artifact

    bad = 0
    for path in _named(inputs_or_stdin(files or [], "the artifacts to verify", several=True)):
        try:
            report = verify_artifact(path)
        except ArtifactError as error:
            bad = error.exit_code
            say(f"ifo: {error}")
        else:
            counts = f"{_count(report.datasets, 'dataset')}, {_count(report.parents, 'parent')}"
            emit(f"ok {path} ({report.kind}, {counts})")
    if bad:
        raise typer.Exit(bad)


def _named(inputs: Sequence[Path]) -> Iterator[Path]:
    """Yield the files among the inputs and the artifacts in folders among them, each once.

    Raises:
        ArtifactError: A folder holds no artifacts.
    """
    from artifacts import KINDS
    from artifacts.paths import files_below, real

    seen: set[Path] = set()
    for given in inputs:
        inside = [given]
        if os.path.isdir(given):
            found = files_below(given, ".h5")
            inside = [path for path in found if path.name.split(".")[-2] in KINDS and path.name.count(".") > 1]
            if not inside:
                raise ArtifactError(
                    f"{given}: contains no artifacts: expected files named NAME.KIND.h5 in it or below it"
                )
            if others := len(found) - len(inside):
                say(f"ifo: {given}: {_count(others, 'more .h5 file')} skipped (not named NAME.KIND.h5)")
        for path in inside:
            if real(path) not in seen:
                seen.add(real(path))
                yield path


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
