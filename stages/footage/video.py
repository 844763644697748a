"""Reads a video file frame by frame, with at most two images in memory at a time."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import ArtifactError
from stages.footage.complaints import complaints
from stages.footage.container import check_size, opened, tracks
from stages.footage.decoding import ByCount, ByStamp, Damage, decoded
from stages.footage.display import Display
from stages.footage.scan import scan_packets


class VideoFile:
    """A video's timestamps, read from the packets without decoding them, and its images on demand.

    Attributes:
        label: The file, as named in messages.
        times: Timestamps (F,) of all frames, seconds from the first, increasing.
        begins: Timestamp of the first frame, seconds.
        duration: Seconds, including the last frame's duration.
        cut: Description of what is missing from a truncated file; empty if it is complete.
        damage: Description of the damage that has reached images which `pictures` yielded last; empty if none has.
    """

    def __init__(self, path: Path) -> None:
        """Read the timestamps.

        Raises:
            ArtifactError: The file is not a readable video.
        """
        self.path, self.label, self.damage = path, str(path), ""
        self._notes: list[str] = []
        with complaints() as lines, opened(path) as (container, stream):
            context = stream.codec_context
            aspect, width, height = float(stream.sample_aspect_ratio or 1), context.width, context.height
            self._display = Display(aspect, context.color_trc, context.color_primaries)
            check_size(self.label, width, height)
            check_size(self.label, round(width * self._display.stretch), height)
            if others := len(tracks(container)) - 1:
                number = tracks(container).index(stream) + 1
                self._notes.append(f"of {others + 1} video tracks, number {number} ({width}x{height}) is taken")
            self._unit = float(stream.time_base)
            found = scan_packets(path, container, stream, lines)
        self._by_count, self._keys, self.cut = found.by_count, found.keys, found.cut
        self._unreadable = found.damage
        self._skipped = 0  # frames before the first one that can be decoded
        self._stamps = self._from_first_decodable(found.stamps, found.begins_with_key)
        self._period = float(np.median(np.diff(self._stamps))) if len(self._stamps) > 1 else 0.0
        self.duration = float(self._stamps[-1] - self._stamps[0] + (found.last or self._period)) * self._unit
        self.times = (self._stamps - self._stamps[0]) * self._unit
        self.begins = float(self._stamps[0]) * self._unit

    @property
    def rotation(self) -> int:
        """Counterclockwise rotation applied to images, degrees; known after the first image was read."""
        return self._display.rotation

    @property
    def notes(self) -> list[str]:
        """Remarks for the user, collected while reading."""
        return self._notes + self._display.notes

    def pictures(self, indices: np.ndarray) -> Generator[tuple[float, np.ndarray], None, None]:
        """Yield time and image (H, W, 3), RGB, uint8, upright and with square pixels, of the frames at these indices.

        Args:
            indices: Increasing indices into `times`.

        Raises:
            ArtifactError: A frame cannot be decoded.
        """
        self.damage = self._unreadable
        wanted = [int(index if self._by_count else self._stamps[index]) for index in indices]
        reader = ByCount(self.path, self._skipped) if self._by_count else ByStamp(self.path, self._keys, self._period)
        with closing(reader):
            for index, what in zip(indices, wanted, strict=True):
                found = reader.frame(what)
                if found is None:
                    raise ArtifactError(
                        f"{self.path}: cannot be decoded at {self.times[index]:.2f} s: replace the file, or choose "
                        "another segment with --start and --end"
                    )
                if found.damaged and not self.damage:
                    self.damage = f"is damaged: images are concealed or smeared from {self.times[index]:.2f} s"
                by_stamp = (found.position - self._stamps[0]) * self._unit
                yield float(self.times[index] if self._by_count else by_stamp), self._shown(found.frame)

    def _shown(self, frame: Any) -> np.ndarray:
        import av

        try:
            return self._display.image(frame)
        except (av.error.FFmpegError, ValueError) as error:
            raise ArtifactError(
                f"{self.path}: its colors ({frame.format.name}) cannot be converted: convert it to H.264"
            ) from error

    def _from_first_decodable(self, stamps: np.ndarray, begins_with_key: bool) -> np.ndarray:
        """The timestamps from the first frame that a player shows: recordings may begin between keyframes.

        Raises:
            ArtifactError: No frame can be decoded.
        """
        with opened(self.path) as (container, stream):
            frames = decoded(container, stream, Damage())
            first: Any = next(frames, None)
            if first is None:
                raise ArtifactError(f"{self.path}: cannot be decoded: replace the file")
            if self._by_count and not begins_with_key:
                shown = [first.key_frame, *(frame.key_frame for frame in frames)]
                self._skipped = shown.index(True) if True in shown else 0
                left = stamps[max(len(stamps) - (len(shown) - self._skipped), 0) :]
            else:
                left = stamps[stamps >= self._first(first, begins_with_key)]
        if len(left) < len(stamps):
            without = (left[0] - stamps[0]) * self._unit if len(left) else 0
            self._notes.append(f"begins between keyframes: the first {without:.2f} s have no images and are left out")
        return left if len(left) else stamps

    def _first(self, frame: Any, begins_with_key: bool) -> float:
        """The timestamp from which on frames are shown, given the first frame that a decoder returns."""
        if frame.pts is None or not len(self._keys):
            return -np.inf if frame.pts is None else float(frame.pts)
        if begins_with_key:  # Frames that are stored after it but shown before it may need others that are not there.
            return float(min(frame.pts, self._keys[0]))
        # Some decoders return gray images until the first keyframe.
        later = self._keys[self._keys > frame.pts]
        return float(frame.pts if frame.key_frame or not len(later) else later[0])
