"""Demonstrations to export."""

from __future__ import annotations

import numpy as np

from tests.stages.videos import picture

N, T, FPS = 5, 7, 5
KEY = "observation.images.camera"
NUMBERS = {"timestamp": "float", "frame_index": "int64", "episode_index": "int64", "index": "int64"}
NUMBERS |= {"task_index": "int64"}
LEAST_PSNR = 34  # dB, of pictures with hard edges, at crf 12
FORMATS = {"lerobot": "x.lerobot", "robomimic": "x.robomimic.hdf5", "minari": "x-v0"}


def frames_of(height=48, width=64):
    """Pictures with some noise, so that loss shows."""
    rng = np.random.default_rng(0)
    frames = np.stack([[picture(10 * k + t, height, width) for t in range(T)] for k in range(N)])
    return (np.clip(frames, 5, 250) + rng.integers(-5, 6, frames.shape)).astype(np.uint8)
