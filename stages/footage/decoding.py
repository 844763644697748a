"""Decodes the frames of a video that are wanted, and tells which of them damage has reached."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stages.footage.complaints import complaints
from stages.footage.container import opened

WITH_HIDDEN = ("vp8", "mpeg4")  # decoders of formats in which packets may have no image; it stands for the next ones
HIDDEN = 2  # frames for which the previous image may stay on display
WARM_UP = 32  # frames: twice as many as a decoder can keep to predict others from
# Complaints about what is stored beside the images, which decoders log as errors.
HARMLESS = ("SEI ", "sei ")


@dataclass(frozen=True)
class Decoded:
    """A frame, its position (timestamp or number), and whether damage has reached it.

    Damage has reached a frame if it, or a frame that it was predicted from, is concealed or lost.
    """

    position: int
    frame: Any
    damaged: bool


class ByStamp:
    """Reads frames by timestamp. Seeks to the last keyframe before a frame if that is ahead of the current position."""

    def __init__(self, path: Path, keys: np.ndarray, period: float) -> None:
        """Args:
        path: The file.
        keys: Timestamps of the keyframes.
        period: Time between frames.
        """
        self._path, self._keys = path, keys
        self._slack, self._warm_up = HIDDEN * period, WARM_UP * period
        self._open = ExitStack()
        self._container: Any = None
        self._stream: Any = None
        self._frames: _Forward
        self._certain = True  # Whether nothing before the current position matters.
        self._go_to(None)

    def close(self) -> None:
        """Close the file."""
        self._open.close()

    def frame(self, stamp: int) -> Decoded | None:
        """Return the frame on display at this timestamp, later than the previous one; None if it cannot be decoded."""
        before = np.searchsorted(self._keys, stamp, side="right")
        key = int(self._keys[before - 1]) if before else None
        held = self._frames.held
        if key is not None and key > self._keys[0] and (held is None or key > held.position):
            self._go_to(key)
        found = self._on_display(stamp)
        if found is not None and found.damaged and not self._certain:
            # After seeking, a decoder may only miss what earlier frames left behind.
            earlier = int(np.searchsorted(self._keys, stamp - self._warm_up, side="right")) - 1
            self._go_to(int(self._keys[earlier]) if earlier > 0 else None)
            self._certain = True
            found = self._on_display(stamp)
        if found is None and self._sought:  # Seeking does not work in every file.
            self._go_to(None)
            found = self._on_display(stamp)
        return found

    def _on_display(self, stamp: int) -> Decoded | None:
        found = self._frames.at(stamp)
        # Some packets have no image (hidden frames): the previous image stays on display.
        if found is None or stamp - found.position > self._slack:
            return None
        missing = found.position != stamp and self._stream.codec_context.name not in WITH_HIDDEN
        return replace(found, damaged=found.damaged or missing or self._damage.reached(stamp))

    def _go_to(self, key: int | None) -> None:
        """Continue at a keyframe; None reopens the file, because some files cannot seek back to the beginning."""
        import av

        if key is not None:
            try:
                self._container.seek(key, stream=self._stream, backward=True)
            except av.error.FFmpegError:  # The index is damaged.
                key = None
        if key is None:
            self._open.close()
            self._container, self._stream = self._open.enter_context(opened(self._path))
        self._sought, self._certain = key is not None, key is None
        self._damage = damage = Damage()
        frames = decoded(self._container, self._stream, damage)
        self._frames = _Forward(
            Decoded(frame.pts, frame, frame.is_corrupt or damage.reached(frame.pts))
            for frame in frames
            if frame.pts is not None
        )


class ByCount:
    """Reads frames by number, decoding from the beginning: for containers without presentation times."""

    def __init__(self, path: Path, skipped: int) -> None:
        """Args:
        path: The file.
        skipped: Number of frames at the beginning that are not counted, because they come before a keyframe.
        """
        self._open = ExitStack()
        self._damage = damage = Damage()
        container, stream = self._open.enter_context(opened(path))
        # Packets that were lost have a number, too.
        self._frames = _Forward(
            Decoded(count + damage.lost - skipped, frame, frame.is_corrupt or damage.now or damage.reached(frame.pts))
            for count, frame in enumerate(decoded(container, stream, damage))
        )

    def close(self) -> None:
        """Close the file."""
        self._open.close()

    def frame(self, number: int) -> Decoded | None:
        """Return the frame with this number, from 0, later than the previous one; None if the video ends before it."""
        found = self._frames.at(number)
        if found is None or self._frames.ended:
            return None
        return replace(found, damaged=found.damaged or found.position != number)


class _Forward:
    """Goes forward through frames in order of their positions.

    Attributes:
        held: The frame on display; None at the beginning.
        ended: Whether there are no frames at or after the last position that was asked for.
    """

    def __init__(self, frames: Iterator[Decoded]) -> None:
        self._frames = frames
        self._next: Decoded | None = None
        self.held: Decoded | None = None
        self.ended = False

    def at(self, position: int) -> Decoded | None:
        """Return the last frame that is not after the position; None if there is none."""
        while self.held is None or self.held.position != position:
            if self._next is None:
                self._next = next(self._frames, None)
            self.ended = self._next is None
            if self._next is None or self._next.position > position:
                break
            self.held, self._next = self._next, None
        return self.held


class Damage:
    """Which frames damage has reached, from what the decoder reports packet by packet.

    It lasts until the next keyframe, and reaches leading images: those stored after the keyframe but shown before it,
    which may be predicted from what comes before it. No other image is predicted from them.

    Attributes:
        now: Whether it reaches what is decoded now.
        lost: Number of packets that could not be decoded.
    """

    def __init__(self) -> None:
        self.now, self.lost = False, 0
        self._unsure = False
        self._key = -math.inf  # timestamp of the last keyframe
        self._in_leading = False
        self._stamps: set[int | None] = set()

    def begin(self, packet: Any) -> None:
        """Take note of a packet that is decoded next."""
        # Where a transport stream lost something, that may also be what follows the packet that is marked.
        unsure, self._unsure = self._unsure, packet.is_corrupt
        if unsure or not packet.is_keyframe:
            return
        if packet.pts is not None:
            self._key, self._in_leading, self.now = packet.pts, self.now, False
        elif not packet.stream.codec_context.has_b_frames:
            self.now = False

    def end(self, packet: Any, damaged: bool) -> None:
        """Take note of what decoding the packet showed."""
        if packet.pts is not None and packet.pts < self._key:
            self._in_leading |= damaged
            reached = self._in_leading
        else:
            self.now |= damaged
            reached = self.now
        if reached and packet.pts is not None:
            self._stamps.add(packet.pts)

    def add(self, stamps: set[int | None]) -> None:
        """Let it reach the frames with these timestamps."""
        self._stamps |= stamps

    def spread(self, stamp: int | None, waiting: set[int | None]) -> None:
        """Take note of a corrupt frame: it reaches those that may be predicted from it.

        Args:
            stamp: Its timestamp.
            waiting: Timestamps of the frames that were decoded, but are not returned yet.
        """
        if stamp is None or stamp >= self._key:
            self.now = True
            self._stamps |= waiting
        else:
            self._stamps |= {other for other in waiting if other is not None and other < self._key}

    def reached(self, stamp: int | None) -> bool:
        """Whether it reached the frame with this timestamp, which was decoded before."""
        return stamp in self._stamps


def decoded(container: Any, stream: Any, damage: Damage) -> Iterator[Any]:
    """Yield frames from the current position.

    All of them are decoded, also those that nothing is predicted from: damage may show only there.

    Args:
        container: PyAV's container.
        stream: Its video stream.
        damage: Filled with what decoding shows.
    """
    import av

    context = stream.codec_context
    external = context.name.startswith("lib")
    waiting: set[int | None] = set()
    try:
        for packet in container.demux(stream):
            if not packet.size and packet.dts is not None:
                continue  # A dropped frame of an AVI; a decoder would take it for the end of the file.
            damage.begin(packet)
            frames, errors = _decode(packet, external)
            damage.lost += errors and not frames
            damage.end(packet, errors or packet.is_corrupt)
            waiting.add(packet.pts)
            waiting.difference_update(frame.pts for frame in frames)
            if errors and external:  # It may be about any of the packets whose images are not returned yet.
                damage.add(waiting)
            for frame in frames:
                if frame.is_corrupt:
                    damage.spread(frame.pts, waiting)
            yield from frames
    except av.error.FFmpegError:
        return


def _decode(packet: Any, external: bool) -> tuple[list[Any], bool]:
    """The frames that a decoder returns for a packet, and whether it reports errors.

    External decoders refuse what is damaged. Their log is not read, because it would come from threads that PyAV does
    not wait for.
    """
    import av

    try:
        if external:
            return packet.decode(), False
        with complaints() as lines:
            frames = packet.decode()
    except av.error.FFmpegError:
        return [], True
    return frames, any(not message.startswith(HARMLESS) for _, _, message in lines)
