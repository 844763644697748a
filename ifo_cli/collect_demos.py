"""`ifo collect-demos`: record the expert in many contexts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ifo_cli.options import Given, TaskArgument, stage_command
from ifo_cli.runner import run_stage
from stages.config.environments import PREFIX
from stages.config.task_names import check_task_name

STAGE = "collect-demos"
EXAMPLES = (
    "ifo collect-demos reach --preset quick",
    "ifo collect-demos push --contexts narrow --vary azimuth,colour,goal,initial",
    "ifo collect-demos dm:reacher-easy -n 512",
    "ifo collect-demos push-real --videos footage/ --crf 28",
    "ifo collect-demos env:Reacher-v5 --demonstrator my_policies:reach -n 512",
    "ifo collect-demos reach --preset paper -n 3000 --expert runs/reach-quick.expert.h5",
)


@stage_command(STAGE)
def collect_demos(task: TaskArgument, given: Given) -> None:
    """Record a demonstrator doing a task, each video in a different context.

    The demonstrator is a trained expert, or the scripted demonstrator of a household task. In a Gymnasium environment
    (env:ID, where ID can also be PACKAGE:ID or MODULE:ATTR), it is any policy that --demonstrator names. Viewpoint,
    colors, positions and distractors differ from video to video. Only frames are recorded for learning: no actions and
    no states.
    """
    foreign = task.startswith(PREFIX)
    if not foreign:
        check_task_name(task)
    expert = given.get("expert")

    def call(config: Any, run: Any, paths: list[Path]) -> Any:
        from stages.collect_demos import collect_demos

        return collect_demos(task, config, run, paths[0] if paths else None)

    run_stage(STAGE, given, call, named=[expert] if expert else None, task="" if foreign else task)
