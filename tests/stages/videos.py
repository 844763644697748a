"""Awkward videos, made here: every frame shows its own number, so that it can be read back after compression."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

BITS = 6  # of a frame's number, as columns of black and white
FPS = 10
COUNT = 25  # frames of a video
X265 = {"x265-params": "log-level=none"}


def picture(number: int, height: int = 48, width: int = 64) -> np.ndarray:
    """A frame (height, width, 3): in its central square a red corner, top left, and the number's bits below."""
    side = min(height, width)
    square = np.full((side, side, 3), 90, np.uint8)
    square[: side // 3, : side // 3] = (230, 20, 20)
    for bit in range(BITS):
        left, right = side * bit // BITS, side * (bit + 1) // BITS
        square[side // 2 :, left:right] = 235 if number >> bit & 1 else 20
    frame = np.full((height, width, 3), (20, 160, 60), np.uint8)
    top, left = (height - side) // 2, (width - side) // 2
    frame[top : top + side, left : left + side] = square
    return frame


def number_in(frame: np.ndarray) -> int:
    """The number that a frame (H, W, 3), cropped to its central square, shows; -1 if it is not upright."""
    height, width = frame.shape[:2]
    red, green, _ = frame[height // 12 : height // 4, width // 12 : width // 4].mean(axis=(0, 1))
    if red < 150 or green > 80:
        return -1
    band = frame[height * 5 // 8 : height * 7 // 8].mean(axis=(0, 2))
    middles = [int(width * (bit + 0.5) / BITS) for bit in range(BITS)]
    return sum(int(band[at - 1 : at + 2].mean() > 128) << bit for bit, at in enumerate(middles))


def write_video(
    path: Path,
    codec: str = "libx264",
    pixels: str = "yuv420p",
    *,
    size: tuple[int, int] = (48, 64),
    count: int = COUNT,
    turns: int = 0,
    stretch: int = 1,
    milliseconds: Sequence[int] = (),
    options: dict[str, str] | None = None,
    container: dict[str, str] | None = None,
    audio: int = 0,
    rate: int = FPS,
    metadata: dict[str, str] | None = None,
    matrix: int = 0,
    full: bool = False,
    tags: dict[str, int] | None = None,
    began: float = 0,
) -> Path:
    """Write `count` frames, 10 a second.

    Args:
        size: Height and width of what a player shows.
        turns: Quarter turns that the player is told to make, anticlockwise; the stored picture is turned back.
        stretch: The stored picture is so many times narrower, and its pixels are wider.
        milliseconds: Time stamps in place of 10 a second.
        audio: Seconds of sound beside it.
        rate: Frames a second in place of 10.
        metadata: Title and the like.
        matrix: The matrix that makes YUV of the colors, as numbered in H.273 and by swscale; 0 for BT.601.
        full: Whether values use their full range.
        tags: What the file says of its colors: color_primaries, color_trc, colorspace, color_range.
        began: Seconds at which the first frame is shown.
    """
    with av.open(str(path), "w", options=container or {}) as file:
        file.metadata.update(metadata or {})
        stream = file.add_stream(codec, rate=rate)
        stored = np.rot90(picture(0, *size), -turns)[:, ::stretch]
        stream.height, stream.width, stream.pix_fmt = *stored.shape[:2], pixels
        stream.options = options or {}
        if stretch > 1:
            stream.codec_context.sample_aspect_ratio = Fraction(stretch)
        for name, value in (tags or {}).items():
            setattr(stream.codec_context, name, value)
        if milliseconds:
            stream.codec_context.time_base = Fraction(1, 1000)
        sound = file.add_stream("aac", rate=16000, layout="mono") if audio else None
        file.start_encoding()  # Writes the header, where no frame does.
        for k in range(len(milliseconds) or count):
            turned = np.rot90(picture(k, *size), -turns)[:, ::stretch]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(turned), format="rgb24")
            if milliseconds:
                frame.pts, frame.time_base = milliseconds[k], Fraction(1, 1000)
            if pixels == "rgb8":
                frame = frame.reformat(format=pixels)
            if matrix or full:
                ranges = {"src_color_range": 2, "dst_color_range": 2 if full else 1}
                frame = frame.reformat(format=pixels, dst_colorspace=matrix or 5, **ranges)
            for name, value in (tags or {}).items():
                setattr(frame, name, value)
            if began:
                frame.pts, frame.time_base = k + round(began * rate), Fraction(1, rate)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
        if audio:
            file.mux(_sound(sound, audio))
    if turns:
        set_rotation(path, turns)
    return path


def set_rotation(path: Path, turns: int) -> None:
    """Write the display matrix of an MP4's or MOV's first track: quarter turns, anticlockwise.

    In the bytes, because only PyAV 17 and later have `set_display_rotation`.
    """
    a, b = {0: (1, 0), 1: (0, -1), 2: (-1, 0), 3: (0, 1)}[turns]
    data = bytearray(path.read_bytes())
    matrix = data.index(b"tkhd") + 44  # Version 0: 32 bits for each time.
    for at, value in {0: a, 4: b, 12: -b, 16: a}.items():
        data[matrix + at : matrix + at + 4] = (value << 16).to_bytes(4, "big", signed=True)
    path.write_bytes(bytes(data))


def write_sound(path: Path, seconds: int = 1) -> Path:
    """Write a file of sound alone."""
    with av.open(str(path), "w") as file:
        file.mux(_sound(file.add_stream("aac", rate=16000, layout="mono"), seconds))
    return path


def _sound(stream: av.AudioStream, seconds: int) -> list[av.Packet]:
    packets = []
    for k in range(seconds * 16000 // 1024):
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate, frame.pts = 16000, 1024 * k
        packets += stream.encode(frame)
    return [*packets, *stream.encode()]


def cut(source: Path, path: Path, share: float) -> Path:
    """The first part of a file's bytes."""
    data = source.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


def write_avi(path: Path, dropped: Sequence[int] = (), codec: str = "mjpeg") -> Path:
    """Write an AVI of 25 frames in which these are dropped, as webcams do: their chunks are empty."""
    shown = [k for k in range(COUNT) if k not in dropped]
    encoder = av.CodecContext.create(codec, "w")
    encoder.width = encoder.height = 48
    encoder.pix_fmt, encoder.time_base = "yuvj420p" if codec == "mjpeg" else "yuv420p", Fraction(1, FPS)
    frames = [av.VideoFrame.from_ndarray(picture(k, 48, 48), format="rgb24") for k in shown]
    packets = [bytes(packet) for frame in [*frames, None] for packet in encoder.encode(frame)]
    extra = bytes(encoder.extradata or b"")
    movi, index, at = b"", b"", 4
    for k in range(COUNT):
        data = b"" if k in dropped else packets[shown.index(k)]
        key = 16 if codec == "mjpeg" or not k else 0
        movi += b"00dc" + struct.pack("<I", len(data)) + data + b"\0" * (len(data) % 2)
        index += b"00dc" + struct.pack("<3I", key, at, len(data))
        at += 8 + len(data) + len(data) % 2
    four = {"mjpeg": b"MJPG", "mpeg4": b"FMP4"}[codec]
    head = struct.pack("<14I", 10**6 // FPS, 0, 0, 16, COUNT, 0, 1, 0, 48, 48, 0, 0, 0, 0)
    stream_head = b"vids" + four + struct.pack("<I2H8I4H", 0, 0, 0, 0, 1, FPS, 0, COUNT, 0, 0, 0, 0, 0, 48, 48)
    form = struct.pack("<IiiHH4sIiiII", 40 + len(extra), 48, 48, 1, 24, four, 48 * 48 * 3, 0, 0, 0, 0) + extra
    lists = _chunk(b"avih", head) + _chunk(b"LIST", b"strl" + _chunk(b"strh", stream_head) + _chunk(b"strf", form))
    body = _chunk(b"LIST", b"hdrl" + lists) + _chunk(b"LIST", b"movi" + movi) + _chunk(b"idx1", index)
    path.write_bytes(_chunk(b"RIFF", b"AVI " + body))
    return path


def _chunk(name: bytes, body: bytes) -> bytes:
    return name + struct.pack("<I", len(body)) + body + b"\0" * (len(body) % 2)


def remux(path: Path, *sources: Path, first: int = 0, default: int | None = 0) -> Path:
    """Copy the video tracks of files into one, from packet `first` on; `default` is the default track's number."""
    packets = []
    with contextlib.ExitStack() as stack:
        files = [stack.enter_context(av.open(str(source))) for source in sources]
        out = stack.enter_context(av.open(str(path), "w"))
        for k, file in enumerate(files):
            stream = out.add_stream_from_template(file.streams.video[0], opaque=True)
            stream.disposition = av.stream.Disposition.default.value if k == default else 0
            for number, packet in enumerate(file.demux(video=0)):
                if packet.size and number >= first:
                    packet.stream = stream
                    packets.append((float((packet.dts or 0) * packet.time_base), k, number, packet))
        for *_, packet in sorted(packets, key=lambda item: item[:3]):
            out.mux(packet)
    return path


def damage(path: Path, numbers: Sequence[int], value: int = 0) -> Path:
    """Overwrite the content of these packets of the first video track, counted in the order in which they are stored.

    In MJPEG the beginning is kept, as the decoder would not take what is left for an image.
    """
    with av.open(str(path)) as file:
        places = [bytes(packet) for packet in file.demux(video=0) if packet.size]
    data = bytearray(path.read_bytes())
    for number in numbers:
        at, length = data.index(places[number]), len(places[number])
        keep = length // 2 if places[number].startswith(b"\xff\xd8") else 0
        data[at + keep : at + length] = bytes([value]) * (length - keep)
    path.write_bytes(bytes(data))
    return path
