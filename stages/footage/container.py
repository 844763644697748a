"""Opens a video file: the container, and the video track that a player shows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from artifacts import ArtifactError, open_video
from stages.footage.claims import check_claims

SMALLEST, LARGEST = 16, 16384  # pixels per side
MOST_PIXELS = 2**26  # a frame needs up to eight bytes for each


@contextmanager
def opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open the container and its video track (PyAV objects); close them afterwards.

    Raises:
        ArtifactError: The file is not a readable video.
    """
    container = _open(path)
    with container:
        stream = _choose(path, container)
        if not stream.codec_context.name.startswith("lib"):
            # With a thread per slice, FFmpeg's own decoders do not tell which frames they concealed.
            stream.thread_type = "NONE"
        yield container, stream


def tracks(container: Any) -> list[Any]:
    """The video streams that are videos: not cover art, thumbnails or other single images."""
    from av.stream import Disposition

    images = Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image
    return [stream for stream in container.streams.video if not stream.disposition & images]


def check_size(label: str, width: int, height: int) -> None:
    """Raise ArtifactError for image sizes that no camera produces."""
    if not (SMALLEST <= width <= LARGEST and SMALLEST <= height <= LARGEST):
        raise ArtifactError(
            f"{label}: its image has {width}x{height} pixels: expected {SMALLEST} to {LARGEST} per side"
        )
    if width * height > MOST_PIXELS:
        raise ArtifactError(f"{label}: its image has {width}x{height} pixels: expected at most {MOST_PIXELS}")


def _open(path: Path) -> Any:
    import av

    try:
        check_claims(path)
        return open_video(path)
    except (av.error.FFmpegError, ValueError) as error:
        what = "is not a video, or is truncated" if path.stat().st_size else "is empty"
        raise ArtifactError(f"{path}: {what}: expected MP4, MOV, AVI, WebM or GIF") from error
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error


def _choose(path: Path, container: Any) -> Any:
    """The track that players and FFmpeg show: the default one and, of several, the largest."""
    from av.stream import Disposition

    found = tracks(container)
    decodable = [stream for stream in found if stream.codec_context is not None]
    if not decodable:
        problem = "uses a codec that cannot be decoded here: convert it to H.264"
        raise ArtifactError(f"{path}: {problem if found else 'contains no video stream: expected a video'}")

    def rank(stream: Any) -> tuple[bool, int]:
        context = stream.codec_context
        return bool(stream.disposition & Disposition.default), context.width * context.height

    return max(decodable, key=rank)
