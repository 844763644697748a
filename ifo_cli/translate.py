"""`ifo translate`: translate demonstrations into the learner's context."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ifo_cli.options import Given, stage_command
from ifo_cli.runner import run_stage

STAGE = "translate"
EXAMPLES = (
    "ifo translate runs/reach.translator.h5 --context-seed 3",
    "ifo translate runs/imported.translator.h5 --context-image robot.png",
    "ifo translate runs/reach.translator.h5 -n 20 --out runs/few.translation.h5",
)


@stage_command(STAGE)
def translate(
    given: Given,
    translator: Annotated[
        Path | None, typer.Argument(readable=False, help="Translator (default: the path on standard input).")
    ] = None,
) -> None:
    """Translate demonstrations into the learner's context and average them. The policy will track this average."""

    def call(config: Any, run: Any, paths: list[Path]) -> Any:
        from stages.translate import translate

        return translate(config, run, paths[0])

    run_stage(STAGE, given, call, named=[translator] if translator else [])
