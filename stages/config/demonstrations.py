"""Configuration of the stages that make demonstrations, from simulation or real videos, or export them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from artifacts.encoding import CRF
from artifacts.errors import UsageError
from stages.config.contexts import CONTEXTS_HELP, VARY_HELP, check_contexts
from stages.config.environments import SUCCESS_HELP, check_success, parse_kwargs, parse_viewpoint
from stages.config.fields import Config, Only, one_of, option
from stages.config.names import CAMERA, CONTEXTS, EXPORT_FORMATS, FRAME_SIDES, PLAIN_FPS

MOST_FRAMES = 1000
MOST_FPS = 1000
WORST_CRF = 51
SHOWN = 60  # characters of a wrong value that a message shows


@dataclass(frozen=True)
class DemosConfig(Config):
    """Configuration of collect-demos: videos of a demonstrator in random contexts."""

    n: int = option(3000, "Number of demonstrations to collect.", low=2, names=("-n", "--n"))
    contexts: str = option("paper", f"Distribution of contexts: {CONTEXTS_HELP}.", CONTEXTS, tag="")
    vary: str = option("", VARY_HELP, tag="vary-")
    context_seed: int = option(
        -1,
        "Record all videos in the context that translate gives the learner for this seed (-1: each in its own).",
        low=-1,
        tag="own-context",
    )
    keep_failures: bool = option(False, "Keep demonstrations that failed.")
    jitter: float = option(
        0.0,
        "Vary the playback speed within each video, by up to this fraction faster or slower (distances stay those of "
        "the whole episode).",
        low=0,
        high=1,
        tag="jitter",
    )
    videos: str = option(
        "",
        "Also write each video as an MP4, enlarged 5 times, into this new folder, as camera footage for import-demos.",
        metavar="FOLDER",
    )
    crf: int = option(
        23,
        f"Compression of the MP4s of --videos: x264's constant rate factor, 0 (lossless) to {WORST_CRF}.",
        low=0,
        high=WORST_CRF,
        effect=(Only("videos"),),
    )
    demonstrator: str = option(
        "",
        "Demonstrator in env:ID; MODULE:ATTR (a function of the observation, or an object with predict or get_action) "
        "or a model saved by Stable-Baselines3 (.zip).",
        metavar="NAME",
    )
    env_kwargs: tuple[str, ...] = option((), "Keyword argument of env:ID, KEY=VALUE (repeatable).", off=())
    success: str = option("", SUCCESS_HELP, off="", metavar="NAME")
    episode_steps: int = option(
        0, "Steps per episode of env:ID (0: the environment's own limit).", low=0, high=1_000_000, off=0
    )
    frames: int = option(25, "Frames per video of env:ID, spread evenly over the episode.", low=2, high=MOST_FRAMES)
    size: str = option("48x48", "Frame size of env:ID in pixels, multiples of 4.", metavar="WxH")
    crop: str = option("", "Part of the image of env:ID that is reduced to --size, in pixels.", metavar="X,Y,W,H")
    viewpoint: str = option(
        "",
        "Middle of the viewpoints of env:ID, relative to its own camera: AZIMUTH,ELEVATION,DISTANCE in degrees, "
        "degrees and as a factor; for example 0,0,0.5 comes twice as near (MuJoCo only).",
        off="",
        metavar="A,E,D",
    )
    azimuth: float = option(
        45.0, "Viewpoints of env:ID differ by up to this angle to either side, degrees (MuJoCo only).", low=0, high=180
    )
    elevation: float = option(10.0, "Viewpoints of env:ID differ by up to this elevation, degrees.", low=0, high=60)
    distance: float = option(0.1, "Distances of the camera of env:ID differ by up to this fraction.", low=0, high=0.9)

    def check_together(self) -> None:
        """See `Config.check_together`."""
        check_contexts(self.contexts, self.vary)
        parse_kwargs(self.env_kwargs)
        parse_viewpoint(self.viewpoint)
        check_success(self.success)
        parse_size(self.size)
        if self.crop:
            parse_crop(self.crop)


class Crop(NamedTuple):
    """A rectangle in pixels: left, top, width and height."""

    x: int
    y: int
    w: int
    h: int

    @classmethod
    def of(cls, words: Sequence[str]) -> Crop | None:
        """Return the rectangle given by four words; None: they are not a rectangle."""
        if len(words) != 4 or not all(re.fullmatch(r"\s*[0-9]{1,6}\s*", word) for word in words):
            return None
        crop = cls(*map(int, words))
        return crop if crop.w > 0 and crop.h > 0 else None


def parse_crop(text: str) -> Crop:
    """Return the crop given by `--crop X,Y,W,H`.

    Raises:
        UsageError: The text is not a rectangle.
    """
    crop = Crop.of(text.split(","))
    if crop is None:
        shown = repr(text if len(text) <= SHOWN else f"{text[:SHOWN]}...")
        raise UsageError(f"--crop {shown}: expected X,Y,W,H in whole pixels, for example 200,0,720,720")
    return crop


def parse_size(text: str) -> tuple[int, int]:
    """Return height and width of `--size WIDTHxHEIGHT`.

    Raises:
        UsageError: Translators cannot process frames of this size.
    """
    match = re.fullmatch(r"(\d{1,4})[xX](\d{1,4})", text)
    width, height = (int(side) for side in match.groups()) if match else (0, 0)
    if width not in FRAME_SIDES or height not in FRAME_SIDES:
        raise UsageError(
            f"--size {text!r}: expected WIDTHxHEIGHT in multiples of {FRAME_SIDES.step} from {FRAME_SIDES[0]} to "
            f"{FRAME_SIDES[-1]}, for example 48x48"
        )
    return height, width


@dataclass(frozen=True)
class ImportConfig(Config):
    """Configuration of import-demos: the frames to take from real videos."""

    frames: int = option(25, "Number of frames to take from each video.", low=2, high=MOST_FRAMES)
    size: str = option(
        "48x48", "Width and height of the frames; videos are reduced by area averaging.", metavar="WIDTHxHEIGHT"
    )
    start: float = option(0.0, "Time of the first frame in each video, the context frame.", low=0, metavar="SECONDS")
    end: float = option(0.0, "Time of the last frame (0: the end of each video).", low=0, metavar="SECONDS")
    fps: float = option(
        0.0,
        "Take this many frames per second, starting at --start (0: equal intervals up to the end). Shorter videos "
        "repeat their last frame; a warning is printed.",
        low=0,
    )
    crop: str = option(
        "",
        "Region to take, in pixels of the upright video (default: the largest centered region with the aspect ratio of "
        "--size).",
        metavar="X,Y,W,H",
    )
    crop_file: str = option("", "CSV file with a crop for each video, in the columns video,x,y,w,h.", metavar="CSV")
    task: str = option(
        "",
        "Simulated task that the robot will learn from the videos (default: none).",
        metavar="TASK",
        complete="task",
    )
    strict: bool = option(False, "Stop with an error if a video cannot be used, or damage shows in its frames.")
    camera: str = option(
        "",
        "Camera in a data set, by its name or the last part of its name (default: the only one).",
        metavar="KEY",
    )

    def check_together(self) -> None:
        """Refuse invalid crops, sizes and segments.

        Raises:
            UsageError: The options are invalid.
        """
        parse_size(self.size)
        if self.crop and self.crop_file:
            raise UsageError("--crop and --crop-file both define the region to take: give only one of them")
        if self.crop:
            parse_crop(self.crop)
        if self.end and self.fps:
            raise UsageError("--end and --fps both define the last frame: give only one of them")
        if self.end and self.end <= self.start:
            raise UsageError(f"--end {self.end:g}: expected more than --start, which is {self.start:g}")


@dataclass(frozen=True)
class ExportConfig(Config):
    """Configuration of export-demos: the data set to write."""

    format: str = option("", "Format: LeRobotDataset v3, robomimic's HDF5, or Minari's HDF5.", EXPORT_FORMATS)
    camera: str = option(
        "",
        f"Name of the camera: observation.images.NAME, obs/NAME_image (default: {CAMERA}).",
        effect=(Only("format", ("lerobot", "robomimic")),),
        off="",
        metavar="NAME",
    )
    task: str = option("", "Description of the task in words (default: the task of the demonstrations).")
    fps: int = option(
        0,
        f"Frames per second of the data set (0: from the times of the demonstrations, {PLAIN_FPS} if there are none).",
        low=0,
        high=MOST_FPS,
    )
    video: bool = option(
        False,
        "Store frames as H.264 video instead of PNGs (lerobot only). This halves the color resolution, which shows in "
        "small frames.",
        effect=(Only("format", ("lerobot",)),),
        off=False,
    )
    crf: int = option(
        CRF, f"Compression of --video, 1 (best quality) to {WORST_CRF}.", low=1, high=WORST_CRF, effect=(Only("video"),)
    )

    def check_together(self) -> None:
        """Refuse a missing format, and invalid names of cameras.

        Raises:
            UsageError: The options are invalid.
        """
        if not self.format:
            raise UsageError(f"--format: expected {one_of(EXPORT_FORMATS)}, the format of the data set")
        if self.camera and not re.fullmatch(r"\w[-\w]*", self.camera):
            raise UsageError(f"--camera {self.camera!r}: expected letters, digits, - and _, for example front")
