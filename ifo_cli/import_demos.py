"""`ifo import-demos`: real videos as demonstrations."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated, Literal

import typer

from ifo_cli.options import complete_task
from ifo_cli.runner import check_out
from ifo_cli.streams import emit, inputs_or_stdin, plain, stdout_to_stderr
from stages.config.presets import DEFAULT_PRESET, PRESETS
from stages.config.stages import ImportConfig
from stages.config.task_names import check_task_name, permission_needed

EXAMPLES = (
    "ifo import-demos kitchen/ --preview",
    "ifo import-demos take1.mp4 take2.mov --crop 420,0,1080,1080 --start 1.5 --end 6",
    "ifo import-demos so101_pick/ --camera front --frames 25",
    "ifo import-demos kitchen/ --crop-file crops.csv --out runs/kitchen.demos.h5 | ifo train-translator",
)


def import_demos(
    context: typer.Context,
    videos: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Videos, folders of videos, folders of images, each one video, and data sets of LeRobot, robomimic "
            "or Minari, each episode one video (default: paths on standard input).",
            show_default=False,
        ),
    ] = None,
    crop: Annotated[
        str,
        typer.Option(
            help="What to take of the upright picture, in its pixels (default: the largest centred part of the shape "
            "of --size).",
            metavar="X,Y,W,H",
            show_default=False,
        ),
    ] = ImportConfig.crop,
    crop_file: Annotated[
        str,
        typer.Option(help="A crop for each video: CSV of video,x,y,w,h.", metavar="CSV", show_default=False),
    ] = ImportConfig.crop_file,
    frames: Annotated[int, typer.Option(help="Frames to take of each video.", metavar="INT")] = ImportConfig.frames,
    size: Annotated[
        str, typer.Option(help="Their width and height, by area averaging.", metavar="WIDTHxHEIGHT")
    ] = ImportConfig.size,
    start: Annotated[
        float, typer.Option(help="Time of the first frame in each video, the context frame.", metavar="SECONDS")
    ] = ImportConfig.start,
    end: Annotated[
        float,
        typer.Option(
            help="Time of the last frame (default: each video's own last).", metavar="SECONDS", show_default=False
        ),
    ] = ImportConfig.end,
    fps: Annotated[
        float,
        typer.Option(
            help="Take so many frames a second from --start, in place of equal times to the end; too short a video "
            "rests on its last frame.",
            metavar="FLOAT",
            show_default=False,
        ),
    ] = ImportConfig.fps,
    task: Annotated[
        str,
        typer.Option(
            help="Simulated task that a robot is to learn from the videos (default: none).",
            metavar="TASK",
            autocompletion=complete_task,
            show_default=False,
        ),
    ] = ImportConfig.task,
    camera: Annotated[
        str,
        typer.Option(
            help="Which camera of a data set to take, its name or the last part of it (default: the only one).",
            metavar="KEY",
            show_default=False,
        ),
    ] = ImportConfig.camera,
    preview: Annotated[
        bool,
        typer.Option("--preview", help="Write only a PNG of the first frames with the crops drawn on them."),
    ] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Fail where a video cannot be used.")] = ImportConfig.strict,
    preset: Annotated[
        Literal[tuple(PRESETS)],  # type: ignore[valid-type]
        typer.Option(help="Preset of the stages that follow."),
    ] = DEFAULT_PRESET,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Artifact to write, ending in .h5 (default: runs/imported.demos.h5, or runs/imported-TASK.demos.h5).",
            metavar="PATH",
            show_default=False,
        ),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite", help="Replace a finished artifact at --out (default: keep it if it is the same, else stop)."
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object in place of the path.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No messages on standard error.")] = False,
) -> None:
    """Turn real videos into demonstrations: frames alone, of equal number and size, one video after the other.

    Reads MP4, MOV, AVI, WebM, GIF, folders of PNGs or JPEGs, LeRobotDataset v3, and the HDF5 of robomimic and Minari.
    Rotation and time stamps are heeded. Videos that cannot be used are named, left out and counted.
    """
    task = check_task_name(task) if task else ""
    config = ImportConfig(frames, size, start, end, fps, crop, crop_file, task, strict, camera)
    out = check_out(out)
    paths = inputs_or_stdin(videos or [], "videos, or their folder", several=True)
    words = [*(context.find_root().obj or []), *(() if videos else map(str, paths))]
    with stdout_to_stderr():
        from stages.import_demos import import_demos
        from stages.runtime.progress import Progress
        from stages.runtime.run import RunOptions

        run = RunOptions(
            preset=preset,
            out=out,
            overwrite=overwrite,
            command=shlex.join(["ifo", *words]),
            progress=Progress(quiet=quiet),
        )
        if note := permission_needed(task):
            run.progress.say(note)
        result = import_demos(paths, config, run, preview)
    if as_json:
        kind = "preview" if preview else "demos"
        emit(json.dumps({"path": str(result.path), "kind": kind, **plain(result.summary)}))
    else:
        emit(str(result.path))
