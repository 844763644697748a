"""Reads a video file frame by frame, with at most two images in memory at a time."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import ArtifactError, open_video

SMALLEST, LARGEST = 16, 16384  # pixels per side
WITHOUT_DISPLAY_TIMES = ("avi", "mpeg")  # containers that do not store a presentation time for every frame
STRETCH = 8  # a larger pixel aspect ratio is taken for a wrong header entry
LOST_FRAMES, LOST_SECONDS = 0.02, 0.2  # tolerance for inexact headers: fraction of frames, and seconds


class VideoFile:
    """A video's timestamps, read from the packets without decoding them, and its images on demand.

    Attributes:
        label: The file, as named in messages.
        times: Timestamps (F,) of all frames, seconds from the first, increasing.
        begins: Timestamp of the first frame, seconds.
        duration: Seconds, including the last frame's duration.
        cut: Description of what is missing from a truncated file; empty if it is complete.
        rotation: Counterclockwise rotation applied to images, degrees; known after the first image was read.
        notes: Remarks for the user, collected while reading.
    """

    def __init__(self, path: Path) -> None:
        """Read the timestamps.

        Raises:
            ArtifactError: The file is not a readable video.
        """
        self.path, self.label = path, str(path)
        self.rotation = 0
        self.notes: list[str] = []
        with _opened(path) as (container, stream):
            check_size(self.label, stream.codec_context.width, stream.codec_context.height)
            ratio = float(stream.sample_aspect_ratio or 1)
            self._stretch = ratio if 1 / STRETCH <= ratio <= STRETCH else 1.0
            self._unit = float(stream.time_base)
            self._by_count = container.format.name in WITHOUT_DISPLAY_TIMES
            self._scan(container, stream)
        self.times = (self._stamps - self._stamps[0]) * self._unit
        self.begins = float(self._stamps[0]) * self._unit

    def _scan(self, container: Any, stream: Any) -> None:
        """Collect timestamps, keyframes, the duration, and what is missing compared with the header."""
        import av

        stamps: dict[int, int] = {}  # Timestamp -> duration, in the stream's time base.
        keys: list[int] = []
        packets, broken, ends, decoded_at = 0, False, 0.0, None
        try:
            for packet in container.demux([stream, *container.streams.audio]):
                if not packet.size or packet.is_corrupt:
                    broken |= packet.is_corrupt
                    continue
                stamp = packet.dts if packet.pts is None else packet.pts
                if stamp is not None:
                    ends = max(ends, float((stamp + (packet.duration or 0)) * packet.time_base))
                if packet.stream.index != stream.index:
                    continue
                packets += 1
                decoded_at = decoded_at if packet.dts is None else packet.dts
                self._by_count |= packet.pts is None
                if packet.is_discard or stamp is None:
                    continue
                stamps[stamp] = packet.duration or 0
                if packet.is_keyframe:
                    keys.append(stamp)
        except av.error.FFmpegError:
            broken = True
        broken |= container.format.name == "gif" and not _has_trailer(self.path)
        self.cut = _what_is_cut(container, stream, packets, broken, ends)
        if self.cut and decoded_at is not None:
            # Frames are not stored in presentation order: complete up to here, with gaps after it.
            stamps = {stamp: length for stamp, length in stamps.items() if stamp <= decoded_at}
        if not stamps:
            raise ArtifactError(f"{self.path}: contains no frames: expected a video")
        self._stamps = np.array(sorted(stamps), np.int64)
        self._keys = np.array(sorted(keys), np.int64)
        self._period = float(np.median(np.diff(self._stamps))) if len(stamps) > 1 else 0.0
        last = int(self._stamps[-1])
        self.duration = float(last - self._stamps[0] + (stamps[last] or self._period)) * self._unit

    def pictures(self, indices: np.ndarray) -> Generator[tuple[float, np.ndarray], None, None]:
        """Yield time and image (H, W, 3), RGB, uint8, upright and with square pixels, of the frames at these indices.

        Args:
            indices: Increasing indices into `times`.

        Raises:
            ArtifactError: A frame cannot be decoded.
        """
        wanted = [int(index if self._by_count else self._stamps[index]) for index in indices]
        reader = _ByCount(self.path) if self._by_count else _ByStamp(self.path, self._keys, wanted, 2 * self._period)
        with closing(reader):
            for index, what in zip(indices, wanted, strict=True):
                frame = reader.frame(what)
                if frame is None or frame.is_corrupt:
                    raise ArtifactError(
                        f"{self.path}: cannot be decoded at {self.times[index]:.2f} s: replace the file, or choose "
                        "another segment with --start and --end"
                    )
                if frame.interlaced_frame and not self.notes:
                    self.notes.append("interlaced: each frame mixes lines from two points in time")
                by_stamp = (frame.pts or 0) - self._stamps[0]
                yield float(self.times[index] if self._by_count else by_stamp * self._unit), self._upright(frame)

    def _upright(self, frame: Any) -> np.ndarray:
        """The frame as a player displays it, (H, W, 3)."""
        width = max(round(frame.width * self._stretch), 1)
        picture = frame.reformat(width=width, format="rgb24").to_ndarray()
        mirrored, angle = _orientation(frame)
        turns = round(angle / 90)
        self.rotation = 90 * turns % 360
        return np.rot90(picture[:, ::-1] if mirrored else picture, turns)


class _ByStamp:
    """Reads frames by timestamp. Seeks to the last keyframe before a frame if that is ahead of the current position."""

    def __init__(self, path: Path, keys: np.ndarray, wanted: Sequence[int], slack: float) -> None:
        self._path, self._keys = path, keys
        self._wanted, self._slack = frozenset(wanted), slack
        self._open = ExitStack()
        self._go_to(None)

    def close(self) -> None:
        self._open.close()

    def frame(self, stamp: int) -> Any:
        """Return the frame with this timestamp, later than the previous one; None if it cannot be decoded."""
        before = np.searchsorted(self._keys, stamp, side="right")
        key = int(self._keys[before - 1]) if before else None
        if key is not None and key > self._keys[0] and (self._held is None or key > self._held.pts):
            self._go_to(key)
        found = self._forward_to(stamp)
        if found is None and self._sought:  # Seeking does not work in every file.
            self._go_to(None)
            found = self._forward_to(stamp)
        return found

    def _go_to(self, key: int | None) -> None:
        """Continue at a keyframe; None reopens the file, because some files cannot seek back to the beginning."""
        if key is None:
            self._open.close()
            self._container, self._stream = self._open.enter_context(_opened(self._path))
        else:
            self._container.seek(key, stream=self._stream, backward=True)
        self._sought = key is not None
        self._held = self._next = None
        self._frames = _decoded(self._container, self._stream, self._wanted)

    def _forward_to(self, stamp: int) -> Any:
        while self._held is None or self._held.pts != stamp:
            if self._next is None:
                self._next = next(self._frames, None)
            if self._next is None or self._next.pts > stamp:
                break
            self._held, self._next = self._next, None
        # Some packets have no image (hidden frames): the previous image stays on display.
        near = self._held is not None and stamp - self._held.pts <= self._slack
        return self._held if near else None


class _ByCount:
    """Reads frames by number, decoding from the beginning: for containers without presentation times."""

    def __init__(self, path: Path) -> None:
        self._open = ExitStack()
        self._frames = enumerate(_decoded(*self._open.enter_context(_opened(path)), None))

    def close(self) -> None:
        self._open.close()

    def frame(self, number: int) -> Any:
        """Return the frame with this number, from 0, later than the previous one; None if the video ends before it."""
        return next((frame for count, frame in self._frames if count == number), None)


def _decoded(container: Any, stream: Any, wanted: frozenset[int] | None) -> Iterator[Any]:
    """Yield frames from the current position, decoding only wanted frames and reference frames."""
    import av

    context = stream.codec_context
    # External decoders (libdav1d for AV1) read skip_frame only once, when they are opened.
    skips = not context.name.startswith("lib")
    try:
        for packet in container.demux(stream):
            if packet.is_corrupt:
                continue
            needed = wanted is None or packet.pts is None or packet.pts in wanted
            context.skip_frame = "DEFAULT" if needed or not skips else "NONREF"
            try:
                frames = packet.decode()
            except av.error.FFmpegError:
                continue
            yield from (frame for frame in frames if wanted is None or frame.pts is not None)
    except av.error.FFmpegError:
        return


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    container, stream = _open(path)
    with container:
        yield container, stream


def _open(path: Path) -> tuple[Any, Any]:
    """Open the container and find its first video stream that is not cover art."""
    import av

    try:
        container = open_video(path)
    except PermissionError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    except (av.error.FFmpegError, OSError, ValueError) as error:
        empty = path.is_file() and not path.stat().st_size
        what = "is empty" if empty else "is not a video, or is truncated"
        raise ArtifactError(f"{path}: {what}: expected MP4, MOV, AVI, WebM or GIF") from error
    problem = "contains no video stream: expected a video"
    for stream in container.streams.video:
        if stream.codec_context is None:
            problem = "uses a codec that cannot be decoded here: convert it to H.264"
        elif not stream.disposition & av.stream.Disposition.attached_pic:
            return container, stream
    container.close()
    raise ArtifactError(f"{path}: {problem}")


def check_size(label: str, width: int, height: int) -> None:
    """Raise ArtifactError for image sizes that no camera produces."""
    if not (SMALLEST <= width <= LARGEST and SMALLEST <= height <= LARGEST):
        raise ArtifactError(
            f"{label}: its image has {width}x{height} pixels: expected {SMALLEST} to {LARGEST} per side"
        )


def _what_is_cut(container: Any, stream: Any, packets: int, broken: bool, ends: float) -> str:
    """Description of what is missing compared with the header; empty if nothing is."""
    lost = stream.frames - packets
    if lost > max(1, LOST_FRAMES * stream.frames):
        return f"is truncated to {packets} of {stream.frames} frames"
    # For other containers FFmpeg only estimates the duration.
    if container.format.name.startswith("matroska") and container.duration:
        declared = container.duration / 1e6
        if declared - ends > max(LOST_SECONDS, LOST_FRAMES * declared):
            return f"is truncated to {ends:.2f} of {declared:.2f} s"
    return "is damaged or truncated" if broken else ""


def _has_trailer(path: Path) -> bool:
    """Whether a GIF has its trailer. Its header does not record the length."""
    with open(path, "rb") as file:
        file.seek(max(path.stat().st_size - 64, 0))
        return file.read().rstrip(b"\0\r\n ").endswith(b";")


def _orientation(frame: Any) -> tuple[bool, float]:
    """Whether to mirror the frame horizontally, and by how many degrees to rotate it counterclockwise afterwards."""
    try:
        matrix = frame.side_data.get("DISPLAYMATRIX")
    except ValueError:  # PyAV does not know this kind of side data, but still provides the angle.
        return False, float(frame.rotation)
    if matrix is None:
        return False, 0.0
    a, b, _, c, d = np.frombuffer(bytes(matrix), "<i4")[:5].astype(float)
    mirrored = a * d - b * c < 0
    if mirrored:
        a, b = -a, -b
    return mirrored, -math.degrees(math.atan2(b, a))
