"""`ifo import-demos`: turn real videos into demonstrations."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ifo_cli.options import Given, stage_command
from ifo_cli.runner import check_out, command_line, emit_result, settled_alone
from ifo_cli.streams import inputs_or_stdin, stdout_to_stderr
from stages.config.task_names import check_task_name, permission_needed

EXAMPLES = (
    "ifo import-demos kitchen/ --preview",
    "ifo import-demos take1.mp4 take2.mov --crop 420,0,1080,1080 --start 1.5 --end 6",
    "ifo import-demos so101_pick/ --camera front --frames 25",
    "ifo import-demos kitchen/ --crop-file crops.csv --out runs/kitchen.demos.h5 | ifo train-translator",
)


@stage_command("import-demos")
def import_demos(
    given: Given,
    videos: Annotated[
        list[Path] | None,
        typer.Argument(
            readable=False,
            help="Videos, folders of videos, folders of images (one video each), or LeRobot, robomimic or Minari data "
            "sets (one video per episode) (default: paths on standard input).",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Turn real videos into demonstrations: frames only, with the same number and size of frames for every video.

    Reads MP4, MOV, AVI, WebM, GIF, folders of PNGs or JPEGs, LeRobotDataset v3, and robomimic and Minari HDF5 files.
    Rotation and time stamps are applied. Videos that cannot be used are skipped, reported and counted.
    """
    settled = settled_alone(given)
    if settled is None:
        return
    task = settled.config.task
    if task:
        check_task_name(task)
    out, preview = check_out(given.get("out")), given.get("preview")
    paths = inputs_or_stdin(videos or [], "videos or folders of videos", several=True)
    with stdout_to_stderr():
        from stages.import_demos import import_demos
        from stages.runtime.progress import Progress
        from stages.runtime.run import RunOptions

        run = RunOptions(
            **settled.settings,
            out=out,
            overwrite=given.get("overwrite"),
            command=command_line(given, () if videos else paths),
            progress=Progress(quiet=given.get("quiet")),
            given=settled.given,
        )
        if note := permission_needed(task):
            run.progress.say(note)
        result = import_demos(paths, settled.config, run, preview)
    emit_result(given, result, "preview" if preview else "demos")
