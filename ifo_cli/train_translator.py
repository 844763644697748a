"""`ifo train-translator`: train the network that translates videos between contexts."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from artifacts.errors import IfoError, UsageError
from ifo_cli.options import Given, stage_command
from ifo_cli.runner import run_stage

STAGE = "train-translator"
EXAMPLES = (
    "ifo train-translator runs/reach.demos.h5 --steps 6000",
    "ifo collect-demos reach | ifo train-translator --preset quick",
    "ifo train-translator few.demos.h5 --from runs/reach-quick.translator.h5 --steps 1000",
)


@stage_command(STAGE)
def train_translator(
    given: Given,
    demos: Annotated[
        Path | None, typer.Argument(readable=False, help="Demonstrations (default: the path on standard input).")
    ] = None,
) -> None:
    """Train the network that translates a video from its own context into another.

    --resume continues an interrupted training. On a CPU the result is bit-for-bit the same as without the interruption.
    """
    from stages.runtime.processes import is_main

    base = given.get("base")
    try:
        given = given if base is None else _of_its_arch(given, base)
    except IfoError:  # Of several processes, only the main one reports it.
        if is_main():
            raise
        return

    def call(config: Any, run: Any, paths: list[Path]) -> Any:
        from stages.train_translator import train_translator

        return train_translator(config, run, paths[0], base)

    run_stage(STAGE, given, call, named=[demos] if demos else [])


def _of_its_arch(given: Given, base: Path) -> Given:
    """Return the command line with the architecture of the translator that --from names.

    Raises:
        ArtifactError: The file is not a translator.
        UsageError: --arch names another architecture, or --out the file itself.
    """
    from artifacts import read_artifact
    from stages.translation.bases import architecture

    arch = architecture(read_artifact(base, "translator"))
    asked = given.config.get("arch", arch)
    if asked != arch:
        raise UsageError(f"--arch {asked}: {base} has architecture {arch}; leave --arch out")
    out = given.get("out")
    if out is not None and os.path.realpath(out) == os.path.realpath(base):
        raise UsageError(f"--out {out} would replace the translator that --from names: choose another name")
    return replace(given, config={**given.config, "arch": arch})
