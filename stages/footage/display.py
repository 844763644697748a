"""Turns decoded frames into images as a player displays them: colors, square pixels, upright."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

STRETCH = 8  # a larger pixel aspect ratio is taken for a wrong header entry
HD_WIDTH, HD_HEIGHT = 1280, 577  # pixels; from here on, players take video without color information for BT.709
UNSPECIFIED, BT709 = 2, 1  # in H.273, which numbers primaries, transfer characteristics and matrices
MATRICES = (0, 1, 4, 5, 6, 7, 9)  # those that FFmpeg converts; the others are treated as unspecified
SRGB = 13  # transfer characteristics
HDR = {16: "PQ", 18: "HLG"}  # transfer characteristics
BT2020 = 9  # primaries


class Display:
    """Shows the frames of one video.

    Attributes:
        rotation: Counterclockwise rotation applied to the last image, degrees.
        notes: Remarks for the user.
    """

    def __init__(self, aspect: float, transfer: int = UNSPECIFIED, primaries: int = UNSPECIFIED) -> None:
        """Args:
        aspect: Width of a pixel divided by its height.
        transfer: Transfer characteristics of the stream, for PyAV before 17, whose frames do not tell.
        primaries: The same of its primaries.
        """
        self._transfer, self._primaries = transfer, primaries
        self.stretch = aspect if 1 / STRETCH <= aspect <= STRETCH else 1.0
        self.rotation = 0
        self.notes: list[str] = []

    def image(self, frame: Any) -> np.ndarray:
        """The frame as a player displays it, (H, W, 3), RGB, uint8."""
        if frame.interlaced_frame:
            self._say("interlaced: each frame mixes lines from two points in time")
        picture = self._in_rgb(frame, max(round(frame.width * self.stretch), 1)).to_ndarray()
        mirrored, angle = orientation(frame)
        turns = round(angle / 90)
        self.rotation = 90 * turns % 360
        return np.rot90(picture[:, ::-1] if mirrored else picture, turns)

    def _in_rgb(self, frame: Any, width: int) -> Any:
        options: dict[str, Any] = {"width": width, "format": "rgb24"}
        if frame.colorspace not in MATRICES and not _is_rgb(frame):
            matrix = "ITU709" if _is_hd(frame) else "ITU601"
            options |= {"src_colorspace": matrix, "dst_colorspace": matrix}
            if _is_hd(frame):
                self._say("HD without color information is read as BT.709, as players do")
        transfer = getattr(frame, "color_trc", self._transfer)
        if transfer in HDR or getattr(frame, "color_primaries", self._primaries) == BT2020:
            kind = f"HDR ({HDR[transfer]})" if transfer in HDR else "wide-gamut video"
            own = BT709 if transfer == UNSPECIFIED else transfer
            target = {"dst_color_trc": SRGB if transfer in HDR else own, "dst_color_primaries": BT709}
            try:
                shown = _reformatter().reformat(frame, **options, **target)
            except (TypeError, ValueError, OSError):  # PyAV before 17, or colors that FFmpeg cannot convert
                self._say(f"{kind} is not converted and looks pale: install PyAV 17 or later, or convert it to BT.709")
            else:
                self._say(f"{kind} is converted to SDR in BT.709")
                return shown
        return frame.reformat(**options)

    def _say(self, note: str) -> None:
        if note not in self.notes:
            self.notes.append(note)


@cache
def _reformatter() -> Any:
    """Converts HDR. It is shared because it computes its color table anew only for frames of another kind."""
    from av.video.reformatter import VideoReformatter

    return VideoReformatter()


def _is_rgb(frame: Any) -> bool:
    return frame.format.is_rgb or frame.format.has_palette


def _is_hd(frame: Any) -> bool:
    return frame.width >= HD_WIDTH or frame.height >= HD_HEIGHT


def orientation(frame: Any) -> tuple[bool, float]:
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
