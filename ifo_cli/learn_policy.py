"""`ifo learn-policy`: track the translated demonstrations."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ifo_cli.options import Given, stage_command
from ifo_cli.runner import run_stage

STAGE = "learn-policy"
EXAMPLES = (
    "ifo learn-policy runs/reach-c0.translation.h5 --seed 1",
    "ifo learn-policy runs/reach-c0.translation.h5 --without img --out runs/features-only.policy.h5",
)


@stage_command(STAGE)
def learn_policy(
    given: Given,
    translation: Annotated[
        Path | None, typer.Argument(help="Translation (default: the path on standard input).")
    ] = None,
) -> None:
    """Learn a policy by reinforcement, rewarded for tracking the translated demonstrations.

    An interrupted run continues bit for bit with --resume on a CPU.
    """

    def call(config: Any, run: Any, paths: list[Path]) -> Any:
        from stages.learn_policy import learn_policy

        return learn_policy(config, run, paths[0])

    run_stage(STAGE, given, call, named=[translation] if translation else [])
