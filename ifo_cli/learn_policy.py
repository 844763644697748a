"""`ifo learn-policy`: learn a policy that tracks the translated demonstrations."""

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
        Path | None, typer.Argument(readable=False, help="Translation (default: the path on standard input).")
    ] = None,
) -> None:
    """Learn a policy by reinforcement learning; the reward is for tracking the translated demonstrations.

    --resume continues an interrupted run. On a CPU the result is bit-for-bit the same as without the interruption.
    """

    def call(config: Any, run: Any, paths: list[Path]) -> Any:
        from stages.learn_policy import learn_policy

        return learn_policy(config, run, paths[0])

    run_stage(STAGE, given, call, named=[translation] if translation else [])
