"""Reads the timestamps of a video from its packets, and where the file is cut."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import ArtifactError
from stages.footage.claims import has_trailer, lacks_bytes, loses_sync
from stages.footage.container import opened
from stages.footage.decoding import Damage, decoded

WITHOUT_DISPLAY_TIMES = ("avi", "mpeg")  # containers that do not store a presentation time for every frame

WITH_DURATION = ("matroska,webm", "flv", "asf")  # for other containers FFmpeg only estimates it
UNSURE = "is damaged or truncated"
UNREADABLE = "is damaged: parts of it cannot be read, and what follows may be shown too early"


@dataclass(frozen=True)
class Scan:
    """What the packets of a video tell without being decoded.

    Attributes:
        stamps: Timestamps of the frames in display order, in the stream's time base.
        keys: Timestamps of the keyframes.
        last: Duration of the last frame; 0 if unknown.
        by_count: Whether frames must be counted, because not all of them have a presentation time.
        begins_with_key: Whether the first packet is a keyframe.
        cut: Description of what is missing from a truncated file; empty if it is complete.
        damage: Description of what cannot be read in the middle of the file; empty if all can.
    """

    stamps: np.ndarray
    keys: np.ndarray
    last: int
    by_count: bool
    begins_with_key: bool
    cut: str
    damage: str


def scan_packets(path: Path, container: Any, stream: Any, lines: list[tuple[int, str, str]]) -> Scan:
    """Collect timestamps and keyframes, and what is missing.

    Args:
        path: The file.
        container: PyAV's container, just opened.
        stream: Its video stream.
        lines: What FFmpeg logged since it was opened, and logs: see `complaints`.

    Raises:
        ArtifactError: The file contains no frames, or its timestamps start again.
    """
    import av

    found = _Found(container.format.name in WITHOUT_DISPLAY_TIMES)
    # An AVI's index lists all frames, at its end. Other indices are made while reading, or list only keyframes.
    indexed = len(getattr(stream, "index_entries", ())) if container.format.name == "avi" else 0
    broken = False
    try:
        for packet in container.demux([stream, *container.streams.audio]):
            found.unreadable |= any(name == container.format.name for _, name, _ in lines)
            lines.clear()
            if packet.stream.index == stream.index:
                found.add(path, packet)
            else:
                found.add_end(packet)
    except av.error.FFmpegError:
        broken = True
    cut = _what_is_cut(path, container, stream, found, broken or found.unreadable)
    stamps = found.stamps
    if cut and found.decoded_at is not None:
        # Frames are not stored in presentation order: complete up to here, with gaps after it.
        stamps = {stamp: length for stamp, length in stamps.items() if stamp <= found.decoded_at}
    if not stamps:
        raise ArtifactError(f"{path}: contains no frames: expected a video")
    damaged = found.damaged or indexed > found.packets or (container.format.name == "mpegts" and loses_sync(path))
    ordered = np.array(sorted(stamps), np.int64)
    return Scan(
        stamps=ordered,
        keys=np.array(sorted(found.keys), np.int64),
        last=stamps[int(ordered[-1])],
        by_count=found.by_count,
        begins_with_key=bool(found.begins_with_key),
        cut=cut,
        damage=UNREADABLE if damaged and not cut else "",
    )


class _Found:
    """What packets tell, collected one by one."""

    def __init__(self, by_count: bool) -> None:
        self.stamps: dict[int, int] = {}  # Timestamp -> duration, in the stream's time base.
        self.unsure: dict[int, int] = {}  # The same, of damaged packets that no good one has followed yet.
        self.keys: list[int] = []
        self.begins_with_key: bool | None = None
        self.decoded_at: int | None = None  # decoding time of the last good packet
        self.by_count, self.packets, self.ends = by_count, 0, 0.0
        self.unreadable = False  # whether something after the last good packet could not be read
        self.damaged = False  # the same, before it

    def add(self, path: Path, packet: Any) -> None:
        """Take note of a packet of the video."""
        self.add_end(packet)
        if not packet.size and packet.dts is None:  # the end of the file
            return
        self.packets += 1
        if not packet.size:  # A dropped frame of an AVI: the previous image stays on display.
            return
        self.by_count |= packet.pts is None
        self.begins_with_key = packet.is_keyframe if self.begins_with_key is None else self.begins_with_key
        stamp = packet.dts if packet.pts is None else packet.pts
        if packet.is_discard or stamp is None:
            return
        if packet.is_corrupt:
            self.unsure[stamp] = packet.duration or 0
            return
        self._check_order(path, packet)
        self.decoded_at = self.decoded_at if packet.dts is None else packet.dts
        self.damaged, self.unreadable = self.damaged or self.unreadable, False
        if packet.is_keyframe and not self.unsure:  # What was lost before it may reach beyond it: see Damage.
            self.keys.append(stamp)
        self.stamps |= self.unsure | {stamp: packet.duration or 0}
        self.unsure.clear()

    def add_end(self, packet: Any) -> None:
        """Take note of when a packet of any stream ends."""
        stamp = packet.dts if packet.pts is None else packet.pts
        if packet.size and not packet.is_corrupt and stamp is not None:
            self.ends = max(self.ends, float((stamp + (packet.duration or 0)) * packet.time_base))

    def _check_order(self, path: Path, packet: Any) -> None:
        last = self.decoded_at
        if last is not None and packet.dts is not None and packet.dts < last - 1 / packet.time_base:
            raise ArtifactError(
                f"{path}: its time stamps go back after {float(last * packet.time_base):.2f} s: convert it, for "
                "example with ffmpeg -i OLD NEW"
            )


def _is_damaged(path: Path) -> bool:
    """Whether decoding the whole video reports damage."""
    damage = Damage()
    with opened(path) as (container, stream):
        return any(frame.is_corrupt or damage.now for frame in decoded(container, stream, damage)) or damage.now


def _what_is_cut(path: Path, container: Any, stream: Any, found: _Found, broken: bool) -> str:
    """Description of what is missing; empty if nothing is.

    What a header says about the number of frames or the duration may be wrong. It counts only where the file also ends
    before its container does, or cannot be read to its end.
    """
    if container.format.name == "gif" and not has_trailer(path) and _is_damaged(path):
        return UNSURE
    if not (broken or found.unsure or lacks_bytes(path)):
        return ""
    packets = found.packets - len(found.unsure)
    if stream.frames > packets:
        return f"is truncated to {packets} of {stream.frames} frames"
    declared = (container.duration or 0) / 1e6 if container.format.name in WITH_DURATION else 0.0
    if declared - found.ends > 1.5 / float(stream.average_rate or 10):
        return f"is truncated to {found.ends:.2f} of {declared:.2f} s"
    return "" if stream.frames or declared else UNSURE
