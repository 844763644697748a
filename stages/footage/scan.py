"""Reads the timestamps of a video from its packets, and where the file is cut."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import ArtifactError
from stages.footage.claims import has_trailer, lacks_bytes
from stages.footage.container import opened
from stages.footage.decoding import Damage, decoded

WITHOUT_DISPLAY_TIMES = ("avi", "mpeg")  # containers that do not store a presentation time for every frame

UNSURE = "is damaged or truncated"


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
    """

    stamps: np.ndarray
    keys: np.ndarray
    last: int
    by_count: bool
    begins_with_key: bool
    cut: str


def scan_packets(path: Path, container: Any, stream: Any) -> Scan:
    """Collect timestamps and keyframes, and what is missing.

    Raises:
        ArtifactError: The file contains no frames.
    """
    import av

    stamps: dict[int, int] = {}  # Timestamp -> duration, in the stream's time base.
    unsure: dict[int, int] = {}  # The same, of damaged packets that no good one has followed yet.
    keys: list[int] = []
    begins_with_key: bool | None = None
    by_count = container.format.name in WITHOUT_DISPLAY_TIMES
    packets, broken, ends, decoded_at = 0, False, 0.0, None
    try:
        for packet in container.demux([stream, *container.streams.audio]):
            stamp = packet.dts if packet.pts is None else packet.pts
            if packet.size and not packet.is_corrupt and stamp is not None:
                ends = max(ends, float((stamp + (packet.duration or 0)) * packet.time_base))
            if packet.stream.index != stream.index or (not packet.size and packet.dts is None):
                continue
            packets += 1
            if not packet.size:  # A dropped frame of an AVI: the previous image stays on display.
                continue
            by_count |= packet.pts is None
            begins_with_key = packet.is_keyframe if begins_with_key is None else begins_with_key
            if packet.is_discard or stamp is None:
                continue
            if packet.is_corrupt:
                unsure[stamp] = packet.duration or 0
                continue
            if decoded_at is not None and packet.dts is not None and packet.dts < decoded_at - 1 / packet.time_base:
                at = float(decoded_at * packet.time_base)
                raise ArtifactError(
                    f"{path}: its time stamps go back after {at:.2f} s: repair it, for example with "
                    "ffmpeg -i OLD -c copy NEW"
                )
            decoded_at = decoded_at if packet.dts is None else packet.dts
            if packet.is_keyframe and not unsure:  # What was lost before it may reach beyond it: see Damage.
                keys.append(stamp)
            stamps |= unsure | {stamp: packet.duration or 0}
            unsure.clear()
    except av.error.FFmpegError:
        broken = True
    cut = _what_is_cut(path, container, stream, packets - len(unsure), broken or bool(unsure), ends)
    if cut and decoded_at is not None:
        # Frames are not stored in presentation order: complete up to here, with gaps after it.
        stamps = {stamp: length for stamp, length in stamps.items() if stamp <= decoded_at}
    if not stamps:
        raise ArtifactError(f"{path}: contains no frames: expected a video")
    ordered = np.array(sorted(stamps), np.int64)
    last = stamps[int(ordered[-1])]
    return Scan(ordered, np.array(sorted(keys), np.int64), last, by_count, bool(begins_with_key), cut)


def _is_damaged(path: Path) -> bool:
    """Whether decoding the whole video reports damage."""
    damage = Damage()
    with opened(path) as (container, stream):
        return any(frame.is_corrupt or damage.now for frame in decoded(container, stream, damage, None)) or damage.now


def _what_is_cut(path: Path, container: Any, stream: Any, packets: int, broken: bool, ends: float) -> str:
    """Description of what is missing; empty if nothing is.

    What a header says about the number of frames or the duration may be wrong. It counts only where the file also ends
    before its container does, or cannot be read to its end.
    """
    if container.format.name == "gif" and not has_trailer(path) and _is_damaged(path):
        return UNSURE
    if not (broken or lacks_bytes(path)):
        return ""
    if stream.frames > packets:
        return f"is truncated to {packets} of {stream.frames} frames"
    # For other containers FFmpeg only estimates the duration.
    declared = (container.duration or 0) / 1e6 if container.format.name.startswith("matroska") else 0.0
    if declared - ends > 1.5 / float(stream.average_rate or 10):
        return f"is truncated to {ends:.2f} of {declared:.2f} s"
    return "" if stream.frames or declared else UNSURE
