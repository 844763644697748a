"""Temporal alignment of videos that show the same task at different speeds, by soft dynamic time warping (soft-DTW;
Cuturi and Blondel, 2017).

The paper pairs frames at equal times (Sec. IV.A), which assumes that all demonstrators move at the same speed. Here,
every video gets a frame index that warps it to a common timeline. All later steps (pairs of frames, means over
demonstrations) can then use equal times. Videos from different contexts are compared by their features after
translation into a single context.
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import torch
from torch import Tensor

from artifacts import PlatformError
from stages.translation.layers import evaluating
from stages.translation.networks import Translator, to_images

SMOOTHING = 0.1  # gamma of soft-DTW, in units of the mean squared distance between two frames of a video
EARLY_OR_LATE = 2.0  # prior standard deviation of a video's time offset from the common timeline, in frames
REFERENCES = 64  # maximum number of sequences that determine the common timeline
ROUNDS = 15  # iterations of the optimizer of the barycenter
CHUNK = 32  # videos encoded at once


def require_tslearn() -> None:
    """Check that tslearn is installed.

    Raises:
        PlatformError: tslearn is not installed.
    """
    if find_spec("tslearn") is None:
        raise PlatformError("--align dtw needs tslearn: run pip install 'ifo[align]', or use --align none")


def common_index(sequences: np.ndarray) -> np.ndarray:
    """Compute the frame indices that warp each sequence to the common timeline.

    Args:
        sequences: Features (n, T, D) of n videos, comparable between videos.

    Returns:
        Fractional frame indices (n, T), nondecreasing from 0: sequence i at `index[i, t]` corresponds to the soft-DTW
        barycenter at time t.

    Raises:
        PlatformError: tslearn is not installed.
    """
    require_tslearn()
    from tslearn.barycenters import softdtw_barycenter
    from tslearn.metrics import soft_dtw_alignment

    scaled = _scaled(sequences)
    if scaled.shape[2] == 0:  # Nothing moves, or the features are not finite: keep equal times.
        return np.tile(np.arange(scaled.shape[1], dtype=np.float64), (len(scaled), 1))
    times = np.arange(scaled.shape[1])
    scaled = _with_clock(scaled, times)
    few = scaled[np.linspace(0, len(scaled) - 1, min(REFERENCES, len(scaled))).astype(int)]
    # Initialize with the most typical sequence. The mean over different speeds is blurred and resembles no sequence.
    typical = few[np.square(few - few.mean(axis=0)).sum(axis=(1, 2)).argmin()]
    centre = softdtw_barycenter(list(few), gamma=SMOOTHING, init=typical, max_iter=ROUNDS)
    index = np.empty(scaled.shape[:2])
    for k, sequence in enumerate(scaled):
        path, _ = soft_dtw_alignment(sequence, centre, gamma=SMOOTHING)
        index[k] = (path * times[:, None]).sum(axis=0) / path.sum(axis=0).clip(1e-12)
    index[:, 0] = 0.0  # The context frame stays first.
    return np.maximum.accumulate(index, axis=1)


def _scaled(sequences: np.ndarray) -> np.ndarray:
    """Project sequences (n, T, D) on the directions of motion and scale them.

    After scaling, the mean squared distance between two frames of a sequence is one.
    """
    covariance = np.zeros((sequences.shape[2], sequences.shape[2]))
    for start in range(0, len(sequences), CHUNK):  # In chunks, because a copy of all features would be large.
        part = sequences[start : start + CHUNK]
        moved = (part - part.mean(axis=1, keepdims=True)).reshape(-1, sequences.shape[2]).astype(np.float64)
        covariance += moved.T @ moved
    covariance /= sequences.shape[0] * sequences.shape[1]
    if not np.isfinite(covariance).all():
        return np.zeros((*sequences.shape[:2], 0))
    # Keep the few directions that contain the motion; the run time of soft-DTW grows with the number of dimensions.
    values, directions = np.linalg.eigh(covariance)
    kept = directions[:, values > max(values[-1] * 1e-3, 1e-12)][:, -16:]
    # Subtract the first frame, which removes constant traces of the source context from the translations.
    projected = (sequences - sequences[:, :1]) @ kept.astype(sequences.dtype)
    return projected.astype(np.float64) / np.sqrt(max(2 * values.sum(), 1e-12))


def _with_clock(scaled: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Append time to sequences (n, T, D) as one more feature (n, T, D + 1), to prevent unnecessary warping.

    An offset of d frames costs noise * (d / EARLY_OR_LATE)^2. The noise is the variance of the last frames, which all
    show the end of the task. In time-jittered videos of reach, corresponding frames of the swing were 0.63 frames apart
    at equal times, 1.1 after alignment without this feature, and 0.52 after alignment with it.
    """
    last = scaled[:, -1] - scaled[:, -1].mean(axis=0)
    weight = np.sqrt(np.square(last).sum(axis=1).mean()) / EARLY_OR_LATE
    return np.concatenate([scaled, np.broadcast_to(weight * times[None, :, None], (*scaled.shape[:2], 1))], axis=2)


def at_index(values: Tensor, index: np.ndarray) -> Tensor:
    """Interpolate values (n, T, ...) linearly at fractional times (n, T) from 0 to T - 1."""
    low = np.floor(index).astype(np.int64)
    high = (low + 1).clip(max=values.shape[1] - 1)
    share = torch.from_numpy(index - low).to(values.dtype)
    rows = torch.arange(len(values))[:, None]
    share = share.reshape(*share.shape, *[1] * (values.ndim - 2))
    return values[rows, torch.from_numpy(low)] * (1 - share) + values[rows, torch.from_numpy(high)] * share


@torch.no_grad()
def video_index(model: Translator, frames: Tensor, reference: Tensor, device: str) -> np.ndarray:
    """Compute the frame indices that warp all videos to a common timeline, from their translations into one context.

    Args:
        model: The translator.
        frames: Videos (N, T, H, W, 3), uint8.
        reference: Context frame (H, W, 3), uint8.
        device: Torch device of the model.

    Returns:
        Integer frame indices (N, T).
    """
    features = []
    with evaluating(model):
        context = model.encode_context(to_images(reference[None].to(device)))
        for start in range(0, len(frames), CHUNK):
            videos = frames[start : start + CHUNK]
            z3 = model.translate(model.encode(to_images(videos.flatten(0, 1).to(device))), context)
            features.append(z3.unflatten(0, videos.shape[:2]).cpu().numpy())
    return np.rint(common_index(np.concatenate(features))).astype(np.int64)
