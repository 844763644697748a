"""Encodes the images of a LeRobotDataset: consecutive episodes in H.264 files, or one PNG per image."""

from __future__ import annotations

from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from stages.datasets.export import Export
from stages.datasets.lerobot import VIDEO_PATH

VIDEO_BYTES = 200 * 10**6  # approximate size of a file
CHUNK = 1000  # files per folder
KEY_EVERY = 2  # frames between keyframes: training reads frames in random order


class VideoFiles:
    """Encodes consecutive episodes, starting a new file when one is full."""

    def __init__(self, path: Path, key: str, export: Export) -> None:
        self._path, self._key, self._export = path, key, export
        self._open = ExitStack()
        self._index, self._frames = -1, 0
        self._file: Path | None = None

    def __enter__(self) -> VideoFiles:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None and self._file is not None:
            self._container.mux(self._stream.encode())
        self._open.close()

    def add(self, frames: np.ndarray) -> dict[str, Any]:
        """Encode an episode (T, H, W, 3); return its columns for the table of episodes."""
        import av

        if self._file is None or self._file.stat().st_size >= VIDEO_BYTES:
            self._next_file()
        begins = self._frames
        for k, array in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(array, format="rgb24")
            frame.pts, frame.time_base = self._frames, Fraction(1, self._export.fps)
            if k == 0:
                frame.pict_type = av.video.frame.PictureType.I
            self._container.mux(self._stream.encode(frame))
            self._frames += 1
        return {
            f"videos/{self._key}/chunk_index": self._index // CHUNK,
            f"videos/{self._key}/file_index": self._index % CHUNK,
            f"videos/{self._key}/from_timestamp": begins / self._export.fps,
            f"videos/{self._key}/to_timestamp": self._frames / self._export.fps,
        }

    def _next_file(self) -> None:
        import av

        self.__exit__(None)
        self._index, self._frames = self._index + 1, 0
        name = VIDEO_PATH.format(video_key=self._key, chunk_index=self._index // CHUNK, file_index=self._index % CHUNK)
        self._file = self._path / name
        self._file.parent.mkdir(parents=True, exist_ok=True)
        options = {"movflags": "+faststart"}
        self._container = self._open.enter_context(av.open(str(self._file), "w", format="mp4", options=options))
        self._stream = self._container.add_stream("libx264", rate=self._export.fps)
        self._stream.height, self._stream.width = self._export.shape[2:]
        self._stream.pix_fmt = "yuv420p"
        self._stream.options = {"crf": str(self._export.crf), "preset": "medium", "g": str(KEY_EVERY), "bf": "0"}


def png(frame: np.ndarray) -> bytes:
    """Encode an image (H, W, 3), RGB, uint8, as PNG."""
    import cv2

    return bytes(cv2.imencode(".png", np.ascontiguousarray(frame[..., ::-1]))[1])
