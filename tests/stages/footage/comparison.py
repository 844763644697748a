"""Compares what the import shows of a media file with its source, and with an independent decode."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import av
import numpy as np

from artifacts import ArtifactError
from stages.config.demonstrations import ImportConfig
from stages.footage.sources import Source
from stages.footage.video import VideoFile
from stages.import_demos import Importer
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions
from tests.stages.footage.media import COUNT, Media
from tests.stages.videos import picture

LATE = 2e-3  # seconds; some containers round time stamps to a millisecond
SOURCE_LIMIT = 9.0  # mean difference from the source, of 255: what codecs and half the color resolution cost
PALETTE_LIMIT = 25.0  # the same for GIF
DECODE_LIMIT = 2.5  # mean difference from the other decode, of 255: rounding, and how colors are interpolated
SIZE = re.compile(r"n: *\d+ pts: *\S+ pts_time:(\S+) .* s:(\d+)x(\d+) ")
Frames = tuple[np.ndarray, np.ndarray]  # times (F,), seconds from the first, and images (F, H, W, 3)


@dataclass
class Row:
    """What was measured of a file.

    Attributes:
        media: The file.
        frames: Number of frames that the import finds; -1 if it refuses the file.
        others: Number of frames that the independent decode shows; -1 if they are not compared.
        late: Largest difference of a time from the source's, seconds.
        source: Mean difference of colors from the source, of 255.
        decode: Mean difference of colors from the independent decode, of 255.
        said: What the import said of it.
        wrong: What is not as it should be; empty if all is.
    """

    media: Media
    frames: int = -1
    others: int = -1
    late: float = 0.0
    source: float = 0.0
    decode: float = 0.0
    said: str = ""
    wrong: list[str] = field(default_factory=list)

    @property
    def verdict(self) -> str:
        """In a few words."""
        if self.wrong:
            return f"WRONG: {'; '.join(self.wrong)}".replace("|", "/")
        if self.media.refused:
            return "refused" if self.media.refused == "always" else "told"
        return "agrees, and says so" if self.said else "agrees"

    def check(self, right: bool, what: str) -> None:
        """Take note of what is wrong."""
        if not right:
            self.wrong.append(what)


class Listening(Progress):
    """Keeps what is said instead of printing it."""

    def __init__(self) -> None:
        super().__init__(quiet=True)
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)

    def warn(self, text: str) -> None:
        self.lines.append(text)


def measure(media: Media, folder: Path) -> Row:
    """Write the file, import it, and compare."""
    path = folder / media.name
    media.make(path)
    row = Row(media)
    taken, row.said = imported(path, strict=False)
    in_strict, reason = imported(path, strict=True)
    row.check(taken == (media.refused != "always"), "refused" if not taken else "imported")
    row.check(in_strict == (not media.refused), f"with --strict: {reason or 'imported'}")
    row.check(media.words in row.said if media.words else not row.said, f"said: {row.said!r}")
    if not taken:
        return row
    times, images = frames_of(path)
    row.frames = len(images)
    if media.times is None:
        return row
    row.check(len(times) == len(media.times), f"{len(times)} frames, expected {len(media.times)}")
    if len(times) == len(media.times) and not media.refused:
        row.late = float(np.abs(times - np.asarray(media.times)).max())
        row.check(row.late <= LATE, f"times differ by {row.late:.3f} s")
    if media.refused:
        return row
    numbers, row.source = recognized(images, media.gray)
    row.check(numbers == list(media.shown), f"shows {numbers}")
    row.check(row.source <= (PALETTE_LIMIT if path.suffix == ".gif" else SOURCE_LIMIT), "colors differ from the source")
    if media.exact:
        compare(row, (times, images), independent_decode()(path, media.hd))
    return row


def compare(row: Row, ours: Frames, theirs: Frames) -> None:
    """Compare with the independent decode: number of frames, times and colors."""
    row.others = len(theirs[0])
    row.check(len(ours[0]) == row.others, f"{row.others} frames in the independent decode")
    if len(ours[0]) != row.others:
        return
    row.check(bool(np.abs(ours[0] - theirs[0]).max() <= LATE), "times differ from the independent decode's")
    same = ours[1].shape == theirs[1].shape
    row.check(same, f"size {theirs[1].shape} in the independent decode")
    row.decode = float(np.abs(ours[1].astype(int) - theirs[1]).mean()) if same else 255.0
    row.check(row.decode <= DECODE_LIMIT, f"colors differ by {row.decode:.1f} from the independent decode's")


def imported(path: Path, strict: bool) -> tuple[bool, str]:
    """Whether the import takes frames of the file, and what it says."""
    listening = Listening()
    importer = Importer(ImportConfig(frames=7, strict=strict), RunOptions(progress=listening))
    try:
        taken = importer.take(Source(path)) is not None
    except ArtifactError as error:
        return False, str(error)
    notes = [note for note in importer.notes if "enlarged" not in note]
    return taken, "; ".join([*listening.lines, *notes]).replace(f"{path}: ", "").replace(f"{path.parent}/", "")


def frames_of(path: Path) -> Frames:
    """What the import's reader shows, all of it."""
    video = VideoFile(path)
    shown = list(video.pictures(np.arange(len(video.times))))
    return np.array([time for time, _ in shown]), np.stack([image for _, image in shown])


def recognized(images: np.ndarray, gray: bool) -> tuple[list[int], float]:
    """Which pictures these are, and how much they differ from them on average, of 255."""
    sources = np.stack([picture(k, *images.shape[1:3]) for k in range(COUNT)]).astype(np.float32)
    if gray:
        sources = np.repeat((sources @ np.float32([0.299, 0.587, 0.114]))[..., None], 3, axis=-1)
    numbers, differences = [], []
    for image in images.astype(np.float32):
        # A sixteenth of the pixels is enough to recognize one.
        distances = np.abs(sources[:, 1::4, 1::4] - image[1::4, 1::4]).mean(axis=(1, 2, 3))
        numbers.append(int(distances.argmin()))
        differences.append(np.abs(sources[numbers[-1]] - image).mean())
    return numbers, float(np.mean(differences))


def independent_decode() -> Callable[[Path, bool], Frames]:
    """The command `ffmpeg` where it is installed; else PyAV, frame by frame without seeking or skipping."""
    return with_ffmpeg if shutil.which("ffmpeg") else with_pyav


def with_ffmpeg(path: Path, hd: bool) -> Frames:
    """What the command `ffmpeg` shows: the track that it chooses, rotated, with square pixels."""
    matrix = ":in_color_matrix=bt709" if hd else ""
    scale = f"scale=w='max(1,round(iw*sar))':h=ih:flags=bilinear{matrix}"
    words = [
        "-hide_banner",
        "-nostats",
        "-i",
        path,
        "-vf",
        f"{scale},format=rgb24,showinfo",
        "-fps_mode",
        "passthrough",
    ]
    done = subprocess.run(["ffmpeg", *words, "-f", "rawvideo", "-"], capture_output=True, check=True)
    found = SIZE.findall(done.stderr.decode(errors="replace"))
    times = np.array([float(time) for time, *_ in found])
    width, height = map(int, found[0][1:])
    return times - times[0], np.frombuffer(done.stdout, np.uint8).reshape(-1, height, width, 3)


def with_pyav(path: Path, hd: bool) -> Frames:
    """What PyAV decodes of the largest track, turned as it says."""
    times, images = [], []
    with av.open(str(path)) as file:
        default = [s for s in file.streams.video if s.disposition & av.stream.Disposition.default]
        stream = max(default or file.streams.video, key=lambda stream: stream.width * stream.height)
        aspect = float(stream.sample_aspect_ratio or 1)
        for count, frame in enumerate(file.decode(stream)):
            options = {"src_colorspace": "ITU709"} if hd else {}
            shown = frame.reformat(round(frame.width * aspect), format="rgb24", **options).to_ndarray()
            times.append(
                count / float(stream.average_rate) if frame.pts is None else float(frame.pts * frame.time_base)
            )
            images.append(np.rot90(shown, round(frame.rotation / 90)))
    # AVI stores no presentation times: with B-frames, those of PyAV are in the order of decoding.
    return np.sort(times) - min(times), np.stack(images)


def as_markdown(rows: Sequence[Row]) -> str:
    """The table of results/footage.md."""
    good = sum(not row.wrong for row in rows)
    decodes = sum(row.others >= 0 for row in rows)
    counts = Counter(row.verdict for row in rows)
    agree = counts["agrees"] + counts["agrees, and says so"]
    lines = [
        "# Media files: what the import shows, and what they contain",
        "",
        f"{len(rows)} files, {good} as they should be: {agree} agree with their source in frames, times and colors "
        f"({decodes} of them also with an independent decode, by {decoder()}), {counts['told']} are damaged, which is "
        f"told and refused with `--strict`, and {counts['refused']} are refused.",
        "",
        "Times: largest difference from the source, in milliseconds. Colors: mean difference from the pictures that "
        "were encoded, and from the independent decode, of 255. HDR and what begins between keyframes is compared only "
        "with the source.",
        "",
        "| file | what it is | frames | independent decode | times (ms) | source | decode | said | verdict |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | --- | --- |",
    ]
    for row in rows:
        measured = row.frames >= 0
        shown = measured and not row.media.refused
        cells = [
            row.media.name,
            row.media.what,
            str(row.frames) if measured else "",
            str(row.others) if row.others >= 0 else "",
            f"{1e3 * row.late:.1f}" if shown else "",
            f"{row.source:.1f}" if shown else "",
            f"{row.decode:.1f}" if row.others >= 0 else "",
            row.said.replace("|", "/"),
            row.verdict,
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def decoder() -> str:
    """Name and version of the independent decoder."""
    if independent_decode() is with_pyav:
        return f"PyAV {av.__version__} frame by frame"
    done = subprocess.run(["ffmpeg", "-version"], capture_output=True, text=True, check=True)
    return "ffmpeg " + done.stdout.split()[2]
