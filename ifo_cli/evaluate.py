"""`ifo evaluate`: measure how well finished policies do the task."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ifo_cli.options import Given, stage_command
from ifo_cli.runner import run_stage

STAGE = "evaluate"
EXAMPLES = (
    "ifo evaluate runs/reach-c0.policy.h5 --json",
    "ifo evaluate runs/seed0.policy.h5 runs/seed1.policy.h5 --out runs/both.evaluation.h5",
)


@stage_command(STAGE)
def evaluate(
    given: Given,
    policies: Annotated[
        list[Path] | None,
        typer.Argument(readable=False, help="Policies (default: paths on standard input, one per line)."),
    ] = None,
) -> None:
    """Run finished policies and measure their final distance to the goal, by the task's true distance.

    Several policies with different seeds give a confidence interval over runs.
    """

    def call(config: Any, run: Any, paths: list[Path]) -> Any:
        from stages.evaluate import evaluate

        return evaluate(config, run, paths)

    run_stage(STAGE, given, call, named=policies or [], several=True)
