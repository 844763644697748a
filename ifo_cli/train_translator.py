"""`ifo train-translator`: train the network that translates videos between contexts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ifo_cli.options import Given, stage_command
from ifo_cli.runner import run_stage

STAGE = "train-translator"
EXAMPLES = (
    "ifo train-translator runs/reach.demos.h5 --steps 6000",
    "ifo collect-demos reach | ifo train-translator --preset quick",
)


@stage_command(STAGE)
def train_translator(
    given: Given,
    demos: Annotated[Path | None, typer.Argument(help="Demonstrations (default: the path on standard input).")] = None,
) -> None:
    """Train the network that translates a video from its own context into another.

    --resume continues an interrupted training. On a CPU the result is bit-for-bit the same as without the interruption.
    """

    def call(config: Any, run: Any, paths: list[Path]) -> Any:
        from stages.train_translator import train_translator

        return train_translator(config, run, paths[0])

    run_stage(STAGE, given, call, named=[demos] if demos else [])
