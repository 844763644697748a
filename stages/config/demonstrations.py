"""Configuration of the stages that make demonstrations, from a simulation or from real videos, or export them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from artifacts.encoding import CRF
from artifacts.errors import UsageError
from stages.config.contexts import CONTEXTS_HELP, VARY_HELP, check_contexts
from stages.config.fields import Config, Only, one_of, option
from stages.config.names import CAMERA, CONTEXTS, EXPORT_FORMATS, FRAME_SIDES, PLAIN_FPS

MOST_FRAMES = 1000
MOST_FPS = 1000
WORST_CRF = 51


@dataclass(frozen=True)
class DemosConfig(Config):
    """Demonstrations: videos of a demonstrator in random contexts."""

    n: int = option(3000, "Demonstrations to collect.", low=2, names=("-n", "--n"))
    contexts: str = option("paper", f"Contexts to draw from: {CONTEXTS_HELP}.", CONTEXTS, tag="")
    vary: str = option("", VARY_HELP, tag="vary-")
    context_seed: int = option(
        -1,
        "Record all videos in the context that translate gives a learner for this seed (-1: each in its own context).",
        low=-1,
        tag="own-context",
    )
    keep_failures: bool = option(False, "Keep demonstrations that failed.")
    jitter: float = option(
        0.0,
        "Play each video at a varying speed, up to this share faster or slower (distances stay those of the whole "
        "episode).",
        low=0,
        high=1,
        tag="jitter",
    )
    videos: str = option(
        "",
        "Also write each video as an MP4, 5 times as high and wide, into this new folder: camera footage that "
        "import-demos reads.",
        metavar="FOLDER",
    )
    crf: int = option(
        23,
        f"Compression of these MP4s: x264's constant rate factor, 0 (lossless) to {WORST_CRF}.",
        low=0,
        high=WORST_CRF,
        effect=(Only("videos"),),
    )

    def check_together(self) -> None:
        """See `Config.check_together`."""
        check_contexts(self.contexts, self.vary)


class Crop(NamedTuple):
    """A rectangle in pixels: its left, top, width and height."""

    x: int
    y: int
    w: int
    h: int

    @classmethod
    def of(cls, words: Sequence[str]) -> Crop | None:
        """The rectangle that four words name; None: they name none."""
        try:
            crop = cls(*map(int, words))
        except (ValueError, TypeError):
            return None
        return crop if crop.x >= 0 and crop.y >= 0 and crop.w > 0 and crop.h > 0 else None


def parse_crop(text: str) -> Crop:
    """The crop that `--crop X,Y,W,H` names.

    Raises:
        UsageError: It is no rectangle.
    """
    crop = Crop.of(text.split(","))
    if crop is None:
        raise UsageError(f"--crop {text!r}: expected X,Y,W,H in whole pixels, such as 200,0,720,720")
    return crop


def parse_size(text: str) -> tuple[int, int]:
    """Height and width of `--size WIDTHxHEIGHT`.

    Raises:
        UsageError: No translator takes such frames.
    """
    match = re.fullmatch(r"(\d{1,4})[xX](\d{1,4})", text)
    width, height = (int(side) for side in match.groups()) if match else (0, 0)
    if width not in FRAME_SIDES or height not in FRAME_SIDES:
        raise UsageError(
            f"--size {text!r}: expected WIDTHxHEIGHT in multiples of {FRAME_SIDES.step} from {FRAME_SIDES[0]} to "
            f"{FRAME_SIDES[-1]}, such as 48x48"
        )
    return height, width


@dataclass(frozen=True)
class ImportConfig(Config):
    """What import-demos takes of real videos."""

    frames: int = option(25, "Frames to take of each video.", low=2, high=MOST_FRAMES)
    size: str = option("48x48", "Width and height of the frames, by area averaging.", metavar="WIDTHxHEIGHT")
    start: float = option(0.0, "Time of the first frame in each video, the context frame.", low=0, metavar="SECONDS")
    end: float = option(0.0, "Time of the last frame (0: that of each video).", low=0, metavar="SECONDS")
    fps: float = option(
        0.0,
        "Take this many frames per second from --start on (0: equal intervals up to the end). Shorter videos repeat "
        "their last frame; a warning is printed.",
        low=0,
    )
    crop: str = option(
        "",
        "Region of the upright picture to take, in its pixels (default: the largest centred one of the shape of "
        "--size).",
        metavar="X,Y,W,H",
    )
    crop_file: str = option("", "A crop for each video: a CSV file with columns video,x,y,w,h.", metavar="CSV")
    task: str = option(
        "",
        "Simulated task that a robot is to learn from the videos (default: none).",
        metavar="TASK",
        complete="task",
    )
    strict: bool = option(False, "Fail if a video cannot be used.")
    camera: str = option(
        "",
        "Camera of a data set, by its name or the last part of it (default: the only one).",
        metavar="KEY",
    )

    def check_together(self) -> None:
        """Refuse crops, sizes and segments that make no sense.

        Raises:
            UsageError: One line.
        """
        parse_size(self.size)
        if self.crop and self.crop_file:
            raise UsageError("--crop and --crop-file both say which region to take: give one of them")
        if self.crop:
            parse_crop(self.crop)
        if self.end and self.fps:
            raise UsageError("--end and --fps both say where the last frame is: give one of them")
        if self.end and self.end <= self.start:
            raise UsageError(f"--end {self.end:g}: expected more than --start, which is {self.start:g}")


@dataclass(frozen=True)
class ExportConfig(Config):
    """What export-demos writes."""

    format: str = option("", "Data set to write: LeRobotDataset v3, robomimic's HDF5, or Minari's.", EXPORT_FORMATS)
    camera: str = option(
        "",
        f"Name of the camera: observation.images.NAME, obs/NAME_image (default: {CAMERA}).",
        effect=(Only("format", ("lerobot", "robomimic")),),
        off="",
        metavar="NAME",
    )
    task: str = option("", "What is done, in words (default: the task of the demonstrations).")
    fps: int = option(
        0,
        f"Frames per second of the data set (0: from the times of the demonstrations, {PLAIN_FPS} if there are none).",
        low=0,
        high=MOST_FPS,
    )
    video: bool = option(
        False,
        "Store lerobot's frames as H.264 instead of PNGs. This halves the resolution of colours, which shows in small "
        "frames.",
        effect=(Only("format", ("lerobot",)),),
        off=False,
    )
    crf: int = option(
        CRF, f"Quality of the video, 1 (best) to {WORST_CRF}.", low=1, high=WORST_CRF, effect=(Only("video"),)
    )

    def check_together(self) -> None:
        """Refuse to export in no format, and names of cameras that no file can have.

        Raises:
            UsageError: One line.
        """
        if not self.format:
            raise UsageError(f"--format: expected {one_of(EXPORT_FORMATS)}, the data set to write")
        if self.camera and not re.fullmatch(r"\w[-\w]*", self.camera):
            raise UsageError(f"--camera {self.camera!r}: expected letters, digits, - and _, such as front")
