"""`ifo export-demos`: write demonstrations as a data set for another library."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ifo_cli.options import Given, stage_command
from ifo_cli.runner import command_line, emit_result, settled_alone
from ifo_cli.streams import inputs_or_stdin, stdout_to_stderr

EXAMPLES = (
    "ifo export-demos runs/reach.demos.h5 --format lerobot --out reach_videos --task 'reach the red disc'",
    "ifo export-demos runs/reach.demos.h5 --format robomimic --camera agentview",
    "ifo collect-demos reach | ifo export-demos --format minari --out ~/.minari/datasets/reach-v0",
)


@stage_command("export-demos")
def export_demos(
    given: Given,
    demos: Annotated[
        Path | None,
        typer.Argument(
            readable=False, help="The demos artifact (default: the path on standard input).", show_default=False
        ),
    ] = None,
) -> None:
    """Write demonstrations as a data set that LeRobot, robomimic or Minari can read.

    Frames are written unchanged, except with --video. Their times are written if the format can store them; contexts
    are not written. Demonstrations have no actions: robomimic and Minari data sets, which must have some, hold
    placeholders that cannot be mistaken for actions.
    """
    settled = settled_alone(given)
    if settled is None:
        return
    path = inputs_or_stdin([demos] if demos else [], "the demos artifact (NAME.demos.h5)")[0]
    with stdout_to_stderr():
        from stages.export_demos import export_demos
        from stages.runtime.progress import Progress
        from stages.runtime.run import RunOptions

        run = RunOptions(
            out=given.get("out"),
            command=command_line(given, () if demos else [path]),
            progress=Progress(quiet=given.get("quiet")),
            given=settled.given,
        )
        result = export_demos(path, settled.config, run)
    emit_result(given, result, settled.config.format)
