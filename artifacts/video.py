"""Videos and images for inspection; stages compute with the arrays. Everything is RGB, uint8, channel last."""

from __future__ import annotations

import math
import struct
import tempfile
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from artifacts.atomic import atomic_path, write_bytes
from artifacts.encoding import CRF
from artifacts.errors import ArtifactError, PlatformError
from artifacts.paths import open_regular, sibling

MIN_HEIGHT = 192  # pixels; smaller videos are enlarged to at least this height
LARGE = 128  # pixels; contact sheets enlarge frames up to this height
GRID_WIDTH = 1536  # pixels; maximum width of an overview's MP4
BACKGROUND = 255
MOST_PIXELS, MOST_BYTES = 2**26, 2**28  # of an image; decoding it needs several bytes for each pixel
PNG_SIZE = struct.Struct(">II")  # width, height
JPEG_SEGMENT = struct.Struct(">BBHxHH")  # 0xFF, type, length, bits per sample, height, width
JPEG_SIZES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # types of the segments that record the size
INK = (0, 0, 0)
FONT_SIZE, LINE, MARGIN = 0.6, 24, 6  # of texts: scale of the font, height of a line and margin, pixels
# The containers that can be read. Others are refused, because a playlist named x.mp4 would make FFmpeg open any file or
# address that it lists.
FORMATS = "mov,avi,matroska,gif,mpegts,mpeg,asf,flv,ogg"


def upscale(frames: np.ndarray, factor: int) -> np.ndarray:
    """Enlarge (..., H, W, C) by an integer factor, nearest neighbor."""
    return frames if factor == 1 else frames.repeat(factor, axis=-3).repeat(factor, axis=-2)


def write_mp4(
    path: str | Path, frames: np.ndarray, fps: float = 10, min_height: int = MIN_HEIGHT, crf: int = CRF
) -> Path:
    """Write (T, H, W, 3) uint8 atomically as H.264, yuv420p, faststart.

    Frames are enlarged by the smallest integer factor that makes them at least `min_height` pixels high, and padded to
    even dimensions by repeating the last row or column. `crf` is x264's constant rate factor: 0 is lossless, 51 the
    lowest quality.
    """
    import av

    frames = _checked(frames, 4)
    factor = max(1, math.ceil(min_height / frames.shape[1]))
    height, width = frames.shape[1] * factor, frames.shape[2] * factor
    padding = ((0, height % 2), (0, width % 2), (0, 0))
    with atomic_path(path) as temporary:
        options = {"movflags": "+faststart"}
        with av.open(str(temporary), "w", format="mp4", options=options) as container:
            stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
            stream.width, stream.height = width + width % 2, height + height % 2
            stream.pix_fmt = "yuv420p"
            stream.options = {"crf": str(crf), "preset": "medium"}
            for frame in frames:
                picture = np.pad(upscale(frame, factor), padding, mode="edge")
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            container.mux(stream.encode())
    return Path(path)


def mp4_bytes(frames: np.ndarray, fps: float = 10, min_height: int = MIN_HEIGHT) -> bytes:
    """Return the MP4 that `write_mp4` writes.

    Raises:
      PlatformError: There is no room for it in the temporary folder.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            return write_mp4(Path(folder) / "video.mp4", frames, fps, min_height).read_bytes()
    except OSError as error:
        raise PlatformError(f"no temporary file can be written ({error.strerror}): free some space") from error


def open_video(path: str | Path) -> Any:
    """Open a video file for reading, as a PyAV container. It behaves the same with PyAV 14 to 19.

    Raises:
      av.error.FFmpegError, OSError, ValueError: The file is missing, or not a video in one of `FORMATS`.
    """
    import av

    open_regular(path).close()  # FFmpeg would wait for the writer of a pipe.

    # Up to version 18, metadata that is not UTF-8 raises an error by default; version 19 never raises.
    lenient: dict[str, Any] = {} if int(av.__version__.split(".")[0]) >= 19 else {"metadata_errors": "ignore"}
    # Without "file:", a name such as concat:x.mp4 would be interpreted as a protocol. `options` cannot be used: up to
    # version 16 they are also applied to the streams, which crashes the interpreter if streams appear only during
    # reading (MPEG-PS).
    return av.open(f"file:{path}", container_options={"format_whitelist": FORMATS}, **lenient)


def read_mp4(path: str | Path) -> np.ndarray:
    """Read a video, an MP4 or another of `FORMATS`, as (T, H, W, 3) uint8.

    Raises:
      ArtifactError: The file is missing, truncated, or not a video.
    """
    import av

    frames: list[np.ndarray] = []
    packets = 0
    try:
        with open_video(path) as container:
            stream = container.streams.video[0]
            expected = stream.frames
            for packet in container.demux(stream):
                packets += packet.size > 0
                if packet.is_corrupt:
                    raise ArtifactError(f"{path}: the video is truncated or damaged: get the file again")
                frames.extend(frame.to_ndarray(format="rgb24") for frame in packet.decode())
    except (av.error.FFmpegError, OSError, IndexError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it contains no video"
        raise ArtifactError(f"{path}: cannot be read as a video ({reason}): expected an MP4") from error
    if packets < expected:
        raise ArtifactError(f"{path}: holds {packets} of {expected} frames, truncated: get the file again")
    if not frames:
        raise ArtifactError(f"{path}: holds no frames: expected a video")
    if len({frame.shape for frame in frames}) > 1:
        raise ArtifactError(f"{path}: the frame size changes within the video: convert it to one size first")
    return np.stack(frames)


def png_bytes(image: np.ndarray) -> bytes:
    """Return (H, W, 3) uint8 RGB as PNG."""
    import cv2

    image = _checked(image, 3)
    _, data = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))
    return data.tobytes()


def write_png(path: str | Path, image: np.ndarray) -> Path:
    """Write (H, W, 3) uint8 RGB as PNG, atomically."""
    return write_bytes(path, png_bytes(image))


def read_png(path: str | Path) -> np.ndarray:
    """Read an image (PNG or JPEG) as (H, W, 3) uint8 RGB.

    Raises:
      ArtifactError: The file is missing, or not an image.
    """
    import cv2

    try:
        with open_regular(path) as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): expected a PNG") from error
    size = image_size(data)
    if size and size[0] * size[1] > MOST_PIXELS:
        raise ArtifactError(f"{path}: its image has {size[0]}x{size[1]} pixels: expected at most {MOST_PIXELS}")
    try:
        complete = size is not None and len(data) <= MOST_BYTES
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if complete else None
    except cv2.error:
        image = None
    if image is None:
        raise ArtifactError(f"{path}: cannot be read as an image: expected a PNG")
    return np.ascontiguousarray(image[..., ::-1])


def image_size(data: bytes) -> tuple[int, int] | None:
    """Width and height that the header of a PNG or JPEG records; None if the data is neither."""
    if data.startswith(b"\x89PNG"):
        return PNG_SIZE.unpack_from(data, 16) if data[12:16] == b"IHDR" and len(data) >= 24 else None
    at = 2
    while data.startswith(b"\xff\xd8") and at + JPEG_SEGMENT.size <= len(data) and data[at] == 0xFF:
        _, kind, length, height, width = JPEG_SEGMENT.unpack_from(data, at)
        if kind in JPEG_SIZES:
            return width, height
        at += 1 if kind == 0xFF else 2 + length  # 0xFF is padding.
    return None


def tile_videos(
    rows: Sequence[Sequence[np.ndarray | str]],
    gap: int = 2,
    labels: Sequence[str] | None = None,
    scale: int = 4,
    row_labels: Sequence[str] | None = None,
) -> np.ndarray:
    """Arrange videos in a grid, to compare them side by side.

    Args:
      rows: Rows of videos (T, H, W, 3), still images (H, W, 3) or texts; a shorter video repeats its last frame. Rows
        may differ in length, and cells in size.
      gap: Pixels between cells, in the output.
      labels: One text per column, drawn above it and shrunk to fit.
      scale: Integer factor by which every cell is enlarged, nearest neighbor.
      row_labels: One text per row, drawn to its left.

    Returns:
      (T, H', W', 3) uint8, as long as the longest video.
    """
    cells = [[cell if isinstance(cell, str) else _as_video(cell) for cell in row] for row in rows]
    videos = [[(i, cell) for i, cell in enumerate(row) if not isinstance(cell, str)] for row in cells]
    if not any(videos):
        raise ValueError("expected at least one video to tile")
    columns = max(map(len, cells))
    for given, count, what in ((labels, columns, "columns"), (row_labels, len(rows), "rows")):
        if given is not None and len(given) != count:
            raise ValueError(f"{len(given)} labels for {count} {what}")
    length = max(len(video) for row in videos for _, video in row)
    heights = [scale * max((video.shape[1] for _, video in row), default=0) or LINE for row in videos]
    widths = []
    for i in range(columns):
        column = [row[i] for row in cells if i < len(row)]
        texts = [_text_width(cell) + 2 * MARGIN for cell in column if isinstance(cell, str)]
        widths.append(
            max((scale * v.shape[2] for v in column if not isinstance(v, str)), default=max(texts, default=0))
        )
    left = max(map(_text_width, row_labels)) + 2 * MARGIN + gap if row_labels else 0
    header = caption(labels, widths, gap) if labels is not None else None
    top = 0 if header is None else header.shape[0] + gap
    height = top + sum(heights) + gap * (len(cells) - 1)
    canvas = np.full((length, height, left + sum(widths) + gap * (columns - 1), 3), BACKGROUND, np.uint8)
    if header is not None:
        canvas[:, : header.shape[0], left:] = header
    tops, lefts = _offsets(heights, gap, top), _offsets(widths, gap, left)
    for k, text in enumerate(row_labels or ()):
        canvas[:, tops[k] : tops[k] + heights[k], : left - gap] = text_card(text, heights[k], left - gap)
    for row, y, row_height in zip(cells, tops, heights, strict=True):
        for cell, x, width in zip(row, lefts, widths, strict=False):
            if isinstance(cell, str):
                canvas[:, y : y + row_height, x : x + width] = text_card(cell, row_height, width)
                continue
            moments = np.minimum(np.arange(length), len(cell) - 1)
            h, w = cell.shape[1] * scale, cell.shape[2] * scale
            canvas[:, y : y + h, x : x + w] = upscale(cell, scale)[moments]
    return canvas


def contact_sheet(frames: np.ndarray, n: int = 20, moments: int = 5) -> np.ndarray:
    """Show up to `n` evenly spaced videos, each as a strip of frames at evenly spaced times.

    Args:
      frames: Videos (N, T, H, W, 3), uint8.
      n: Maximum number of videos.
      moments: Frames per video, including the first and the last.

    Returns:
      An image (H', W', 3), with as many columns of strips as make it about square.
    """
    frames = _checked(frames, 5)
    videos = np.unique(np.linspace(0, len(frames) - 1, min(n, len(frames))).round().astype(int))
    times = np.linspace(0, frames.shape[1] - 1, moments).round().astype(int)
    strips = [list(frames[video][times]) for video in videos]
    columns = max(1, round(math.sqrt(len(strips) / moments)))
    depth = math.ceil(len(strips) / columns)
    rows: list[list[np.ndarray]] = [[cell for strip in strips[i::depth] for cell in strip] for i in range(depth)]
    return tile_videos(rows, scale=2 if frames.shape[2] <= LARGE else 1)[0]


def overview(videos: np.ndarray) -> np.ndarray:
    """Arrange the first videos of (N, T, H, W, 3), uint8, in a grid; returns one video (T, H', W', 3)."""
    height, width = videos.shape[2:4]
    scale = max(1, MIN_HEIGHT // height)
    columns = max(1, min(6, GRID_WIDTH // (scale * width)))
    shown = list(videos[: 4 * columns])
    rows = [shown[k : k + columns] for k in range(0, len(shown), columns)]
    rows[-1] += [np.zeros_like(shown[0])] * (len(rows[0]) - len(rows[-1]))
    return tile_videos(rows, scale=scale)


def write_overview(artifact: str | Path, videos: np.ndarray) -> dict[str, str]:
    """Write files for inspection next to a demos artifact: a contact sheet, and an MP4 of the first videos in a grid.

    Args:
      artifact: Path of the artifact.
      videos: Videos (N, T, H, W, 3), uint8.

    Returns:
      The paths, as `contact_sheet` and `video`.
    """
    sheet = write_png(sibling(artifact, ".png"), contact_sheet(videos, n=20))
    video = write_mp4(sibling(artifact, ".mp4"), overview(videos))
    return {"contact_sheet": str(sheet), "video": str(video)}


def _checked(frames: np.ndarray, ndim: int) -> np.ndarray:
    frames = np.asarray(frames)
    if frames.ndim != ndim or frames.shape[-1] != 3 or frames.dtype != np.uint8 or frames.size == 0:
        raise ValueError(f"expected {ndim} axes, the last of 3 colors, uint8; got {frames.shape} {frames.dtype}")
    return frames


def _offsets(sizes: Sequence[int], gap: int, start: int = 0) -> list[int]:
    return [start + sum(sizes[:i]) + gap * i for i in range(len(sizes))]


def caption(labels: Sequence[str], widths: Sequence[int], gap: int = 0) -> np.ndarray:
    """Return an image (24, W, 3), uint8, with one text per column, shrunk to fit."""
    header = np.full((LINE, sum(widths) + gap * (len(widths) - 1), 3), BACKGROUND, np.uint8)
    for text, x, width in zip(labels, _offsets(widths, gap), widths, strict=True):
        header[:, x : x + width] = text_card(text, LINE, width)
    return header


def text_card(text: str, height: int, width: int) -> np.ndarray:
    """Return an image (height, width, 3), uint8, with a text in its middle, shrunk to fit its width."""
    import cv2

    card = np.full((height, width, 3), BACKGROUND, np.uint8)
    size = FONT_SIZE * min(1.0, max(width - 4, 1) / max(_text_width(text), 1))
    (drawn, tall), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    at = ((width - drawn) // 2, (height + tall) // 2)
    cv2.putText(card, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA)
    return card


def _text_width(text: str) -> int:
    import cv2

    return int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, FONT_SIZE, 1)[0][0])


def _as_video(cell: np.ndarray) -> np.ndarray:
    return _checked(cell if np.ndim(cell) == 4 else np.asarray(cell)[None], 4)
