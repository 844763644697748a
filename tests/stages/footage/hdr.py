"""HDR and wide-gamut video made from ordinary pictures, by the formulas of BT.2100: it shows the same colors."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np

from tests.stages.videos import COUNT, FPS, picture

SDR, PQ, HLG = 14, 16, 18  # transfer characteristics, as numbered in H.273
WHITE = 203  # nits of white in BT.2408
TO_BT2020 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
LUMA = np.array([0.2627, 0.6780, 0.0593])


def write_hdr(path: Path, transfer: int) -> Path:
    """Write pictures as HEVC with 10 bits, BT.2020 and this transfer."""
    tags = {"color_primaries": 9, "color_trc": transfer, "colorspace": 9, "color_range": 1}
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx265", rate=FPS)
        stream.height, stream.width, stream.pix_fmt = 64, 64, "yuv420p10le"
        stream.options = {"x265-params": "log-level=none", "crf": "8"}
        for name, value in tags.items():
            setattr(stream.codec_context, name, value)
        for k in range(COUNT):
            frame = av.VideoFrame(64, 64, "yuv420p10le")
            for plane, values in zip(frame.planes, _planes(picture(k, 64, 64), transfer), strict=True):
                rows = np.zeros((plane.height, plane.line_size // 2), np.uint16)
                rows[:, : values.shape[1]] = values
                plane.update(rows.tobytes())
            for name, value in tags.items():
                setattr(frame, name, value)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    return path


def _planes(image: np.ndarray, transfer: int) -> list[np.ndarray]:
    """Y, Cb and Cr of an sRGB image (H, W, 3), with 10 bits in limited range."""
    value = image / 255
    if transfer == SDR:
        light = np.where(value < 0.081, value / 4.5, ((value + 0.099) / 1.099) ** (1 / 0.45)) @ TO_BT2020.T
        signal = np.where(light < 0.018, 4.5 * light, 1.099 * light**0.45 - 0.099)
    else:
        light = WHITE * np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4) @ TO_BT2020.T
        signal = _pq(light / 10000) if transfer == PQ else _hlg(light / 1000)
    luma = signal @ LUMA
    blue, red = ((signal[..., 2] - luma) / 1.8814)[::2, ::2], ((signal[..., 0] - luma) / 1.4746)[::2, ::2]
    return [np.round(plane).astype(np.uint16) for plane in (64 + 876 * luma, 512 + 896 * blue, 512 + 896 * red)]


def _pq(light: np.ndarray) -> np.ndarray:
    power = np.clip(light, 0, 1) ** 0.1593017578125
    return ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375


def _hlg(light: np.ndarray) -> np.ndarray:
    scene = light * np.maximum(light @ LUMA, 1e-9)[..., None] ** (-0.2 / 1.2)  # the inverse of a display's OOTF
    curve = 0.17883277 * np.log(np.maximum(12 * scene - 0.28466892, 1e-9)) + 0.55991073
    return np.where(scene <= 1 / 12, np.sqrt(3 * scene), curve)
