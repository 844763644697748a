"""Functions that write media files of many kinds; the files themselves are listed in catalog.py."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path

import av
import numpy as np

from tests.stages.videos import COUNT, FPS, cut, damage, picture, remux, write_avi, write_video

TENTHS = [k / FPS for k in range(COUNT)]
PAL = [k / 25 for k in range(COUNT)]


@dataclass(frozen=True)
class Media:
    """A file, and what is right.

    Attributes:
        name: The file's name.
        what: Description.
        make: Function that writes it.
        shown: Numbers of the pictures that it shows.
        times: When it shows them, in seconds from the first; None if it is not known what is left.
        words: What the import must say of it; empty if nothing.
        refused: Whether it is refused: "always", only with "--strict", or never ("").
        gray: Whether it has no colors.
        hd: Whether a player takes it for BT.709 without being told.
        exact: Whether ffmpeg shows the same images; False where it shows concealed ones, or does not convert HDR.
    """

    name: str
    what: str
    make: Callable[[Path], object]
    shown: Sequence[int] = range(COUNT)
    times: Sequence[float] | None = ()
    words: str = ""
    refused: str = ""
    hd: bool = False
    gray: bool = False
    exact: bool = True


def video(name: str, what: str, codec: str = "libx264", pixels: str = "yuv420p", *, more=None, **options) -> Media:
    """A video that write_video writes; `more` are the other fields of Media."""
    times = PAL if options.get("rate") == 25 else [k / options.get("rate", FPS) for k in range(COUNT)]
    return Media(
        name, what, partial(write_video, codec=codec, pixels=pixels, **options), **{"times": times} | (more or {})
    )


def changed(change: Callable[[bytearray], object], **options) -> Callable[[Path], None]:
    """A function that writes a video and changes its bytes."""

    def make(path: Path) -> None:
        data = bytearray(write_video(path, **options).read_bytes())
        change(data)
        path.write_bytes(bytes(data))

    return make


def put(data: bytearray, after: bytes, offset: int, value: bytes, nth: int = 0) -> None:
    """Overwrite bytes at an offset from the nth place that has these."""
    at = -1
    for _ in range(nth + 1):
        at = data.index(after, at + 1)
    data[at + offset : at + offset + len(value)] = value


def turned(a: int, b: int, c: int, d: int) -> Callable[[bytearray], None]:
    """A change of the display matrix of an MP4's first track."""

    def change(data: bytearray) -> None:
        matrix = data.index(b"tkhd") + 44
        for at, value in ((0, a), (4, b), (12, c), (16, d)):
            data[matrix + at : matrix + at + 4] = (value << 16).to_bytes(4, "big", signed=True)

    return change


def oriented(name: str, what: str, matrix: tuple[int, int, int, int], store: Callable) -> Media:
    """A video whose pictures are stored turned or mirrored, with the matrix that undoes it."""

    def make(path: Path) -> None:
        with av.open(str(path), "w") as file:
            stream = file.add_stream("libx264", rate=FPS)
            first = store(picture(0))
            stream.height, stream.width, stream.pix_fmt = *first.shape[:2], "yuv420p"
            for k in range(COUNT):
                stored = np.ascontiguousarray(store(picture(k)))
                file.mux(stream.encode(av.VideoFrame.from_ndarray(stored, format="rgb24")))
            file.mux(stream.encode())
        data = bytearray(path.read_bytes())
        turned(*matrix)(data)
        path.write_bytes(bytes(data))

    return Media(name, what, make, times=TENTHS)


def remuxed(
    suffix: str, codec: str, first: int | None, options: dict[str, str], rate: int = FPS
) -> Callable[[Path], None]:
    """A function that writes the packets of a video from one on; None: from the second keyframe."""

    def make(path: Path) -> None:
        whole = write_video(path.with_name(f"whole{suffix}"), codec, options=options, rate=rate)
        with av.open(str(whole)) as file:
            keys = [k for k, packet in enumerate(file.demux(video=0)) if packet.is_keyframe]
        remux(path, whole, first=keys[1] if first is None else first)
        whole.unlink()

    return make


def two_tracks(path: Path, default: int | None) -> None:
    """A large track and a small one that is all white."""
    small, large = path.with_name("small.mp4"), write_video(path.with_name("large.mp4"))
    with av.open(str(small), "w") as file:
        stream = file.add_stream("libx264", rate=FPS)
        stream.height, stream.width, stream.pix_fmt = 32, 32, "yuv420p"
        for _ in range(COUNT):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((32, 32, 3), 255, np.uint8), format="rgb24")))
        file.mux(stream.encode())
    remux(path, *((large, small) if default == 0 else (small, large)), default=default)
    small.unlink()
    large.unlink()


def cover_art(path: Path) -> None:
    """A video with a picture for its cover, which is a video stream before the video's own."""
    whole = write_video(path.with_name("whole.mp4"))
    cover = av.CodecContext.create("mjpeg", "w")
    cover.width, cover.height, cover.pix_fmt, cover.time_base = 320, 240, "yuvj420p", Fraction(1, FPS)
    [packet, *_] = [*cover.encode(av.VideoFrame.from_ndarray(np.full((240, 320, 3), 99, np.uint8))), *cover.encode()]
    with av.open(str(whole)) as file, av.open(str(path), "w") as out:
        first = out.add_mux_stream("mjpeg", rate=FPS, width=320, height=240)
        first.disposition = av.stream.Disposition.attached_pic.value
        stream = out.add_stream_from_template(file.streams.video[0], opaque=True)
        packet.stream, packet.pts, packet.dts = first, 0, 0
        packet.time_base = Fraction(1, FPS)
        out.mux(packet)
        for packet in file.demux(video=0):
            if packet.size:
                packet.stream = stream
                out.mux(packet)
    whole.unlink()


def shifted(path: Path, seconds: float) -> None:
    """A video whose time stamps begin later or, trimmed by an edit list, before zero."""
    whole = write_video(path.with_name(f"whole{path.suffix}"), options={"g": "12", "bf": "2"})
    with av.open(str(whole)) as file, av.open(str(path), "w", options={"avoid_negative_ts": "disabled"}) as out:
        stream = out.add_stream_from_template(file.streams.video[0], opaque=True)
        offset = round(seconds / file.streams.video[0].time_base)
        for packet in file.demux(video=0):
            if packet.size:
                packet.pts, packet.dts, packet.stream = packet.pts + offset, packet.dts + offset, stream
                out.mux(packet)
    whole.unlink()


def damaged(numbers: Sequence[int], **options) -> Callable[[Path], None]:
    """A function that writes a video and fills these packets with zeros."""
    return lambda path: damage(write_video(path, **options), numbers)


def overwritten(begin: float, end: float, **options) -> Callable[[Path], None]:
    """A function that writes a video and overwrites a part of its bytes, between these fractions."""

    def make(path: Path) -> None:
        data = bytearray(write_video(path, **options).read_bytes())
        first, last = (int(share * len(data)) for share in (begin, end))
        data[first:last] = bytes(last - first)
        path.write_bytes(bytes(data))

    return make


def shortened(share: float, **options) -> Callable[[Path], None]:
    """A function that writes the first part of a video."""
    return lambda path: cut(write_video(path, **options), path, share)


def without_blocks(path: Path) -> None:
    """A transport stream that lost some of its blocks of 188 bytes on the way."""
    data = write_video(path, options={"g": "25", "bf": "0"}).read_bytes()
    blocks = [data[k : k + 188] for k in range(0, len(data), 188)]
    path.write_bytes(b"".join(block for k, block in enumerate(blocks) if not 60 <= k < 64))


def resized(path: Path) -> None:
    """A stream of which the second half has another size, as cameras make when they turn."""
    joined(path, {}, {"size": (64, 48), "began": 2.5})


def joined(path: Path, *options: dict) -> None:
    """Transport streams, one after the other."""
    parts = [write_video(path.with_name("part.ts"), **each).read_bytes() for each in options]
    path.with_name("part.ts").unlink()
    path.write_bytes(b"".join(parts))


def end_edit(data: bytearray) -> None:
    """Let the edit list of an MP4 end after 1.5 s; the frames after that are not shown."""
    put(data, b"elst", 12, struct.pack(">I", 1500))


def unfinished(path: Path) -> None:
    """An AVI whose recorder lost power: sizes and counts are zero, the index is missing."""
    data = bytearray(write_avi(path).read_bytes())
    del data[data.index(b"idx1") :]
    for after, offset in ((b"RIFF", 4), (b"avih", 24), (b"strh", 40), (b"movi", -4)):
        put(data, after, offset, bytes(4))
    path.write_bytes(bytes(data))
