"""`ifo export-demos`: demonstrations as a data set of another library."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated, Literal

import typer

from ifo_cli.streams import emit, inputs_or_stdin, plain, stdout_to_stderr
from stages.config.stages import CAMERA, EXPORT_FORMATS, PLAIN_FPS, VIDEO_CRF, ExportConfig

EXAMPLES = (
    "ifo export-demos runs/reach.demos.h5 --format lerobot --out reach_videos --task 'reach the red disc'",
    "ifo export-demos runs/reach.demos.h5 --format robomimic --camera agentview",
    "ifo collect-demos reach | ifo export-demos --format minari --out ~/.minari/datasets/reach-v0",
)


def export_demos(
    context: typer.Context,
    to: Annotated[
        Literal[tuple(EXPORT_FORMATS)],  # type: ignore[valid-type]
        typer.Option("--format", help="Whose data set: LeRobotDataset v3, robomimic's HDF5, or Minari's."),
    ],
    demos: Annotated[
        Path | None,
        typer.Argument(help="The demos artifact (default: the path on standard input).", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder to write, for robomimic a file; nothing may lie there yet (default: beside the artifact, "
            "NAME.lerobot, NAME.robomimic.hdf5 or NAME-v0).",
            metavar="PATH",
            show_default=False,
        ),
    ] = None,
    camera: Annotated[
        str,
        typer.Option(
            help=f"Name of the camera: observation.images.NAME, obs/NAME_image (default: {CAMERA}).",
            metavar="NAME",
            show_default=False,
        ),
    ] = ExportConfig.camera,
    task: Annotated[
        str,
        typer.Option(
            help="What is done, in words (default: the demonstrations' task).", metavar="TEXT", show_default=False
        ),
    ] = ExportConfig.task,
    fps: Annotated[
        int,
        typer.Option(
            help=f"Frames a second that it claims (default: by the demonstrations' times, {PLAIN_FPS} without any).",
            metavar="INT",
            show_default=False,
        ),
    ] = ExportConfig.fps,
    video: Annotated[
        bool,
        typer.Option(
            "--video",
            help="Store lerobot's frames as H.264 in place of PNGs. Colours lose half of their resolution, which shows "
            "in small frames.",
        ),
    ] = ExportConfig.video,
    crf: Annotated[
        int,
        typer.Option(
            help=f"Quality of the video, 1 the best and 51 the worst (default: {VIDEO_CRF}).",
            metavar="INT",
            show_default=False,
        ),
    ] = ExportConfig.crf,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object in place of the path.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No messages on standard error.")] = False,
) -> None:
    """Write demonstrations as a data set that LeRobot, robomimic or Minari reads.

    Frames go along as they are, but for --video, and times where the format has room for them; contexts do not.
    Nobody recorded actions: robomimic's and Minari's place for them says so.
    """
    path = inputs_or_stdin([demos] if demos else [], "the demos artifact (NAME.demos.h5)")[0]
    words = [*(context.find_root().obj or []), *(() if demos else [str(path)])]
    config = ExportConfig(str(to), camera, task, fps, video, crf)
    with stdout_to_stderr():
        from stages.export_demos import export_demos
        from stages.runtime.progress import Progress
        from stages.runtime.run import RunOptions

        run = RunOptions(out=out, command=shlex.join(["ifo", *words]), progress=Progress(quiet=quiet))
        result = export_demos(path, config, run)
    if as_json:
        emit(json.dumps({"path": str(result.path), "kind": config.format, **plain(result.summary)}))
    else:
        emit(str(result.path))
