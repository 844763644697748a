"""`ifo train-expert`: train the demonstrator with the task's own reward."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ifo_cli.options import Given, TaskArgument, stage_command
from ifo_cli.runner import run_stage
from stages.config.task_names import check_task_name

STAGE = "train-expert"
EXAMPLES = (
    "ifo train-expert reach --preset quick",
    "ifo train-expert dm:finger-turn_hard --iterations 200",
    "ifo train-expert reach --iterations 120 --out runs/long.expert.h5",
)


@stage_command(STAGE)
def train_expert(task: TaskArgument, given: Given) -> None:
    """Train the expert that demonstrates a task, with the task's own reward.

    The expert observes the state and the goal; the learner never does. `ifo collect-demos` trains an expert
    automatically if you do not name one.
    """
    check_task_name(task)

    def call(config: Any, run: Any, _: list[Path]) -> Any:
        from stages.train_expert import train_expert

        return train_expert(task, config, run)

    run_stage(STAGE, given, call, named=None, task=task)
