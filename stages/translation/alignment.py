"""Alignment in time by soft dynamic time warping (Cuturi and Blondel, 2017), of videos that show the same at their
own tempo.

The paper pairs frames of equal time (Sec. IV.A), as if all demonstrators kept one tempo. Here every video gets an index
of frames that brings it to a common tempo; what follows (pairs of frames, means over demonstrations) works on equal
times again. Videos of different contexts are compared by their features after translation into one and the same
context, which is what the translator is for.
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import torch
from torch import Tensor

from artifacts import PlatformError
from stages.translation.layers import evaluating
from stages.translation.networks import Translator, to_images

SMOOTHING = 0.1  # soft-DTW's gamma, in units of the mean squared distance between two frames of a video
EARLY_OR_LATE = 2.0  # frames that a video is off the common tempo by, as a standard deviation: a guess before looking
REFERENCES = 64  # sequences that the common tempo is found from
ROUNDS = 15  # of the barycentre's optimiser
CHUNK = 32  # videos encoded at a time


def require_tslearn() -> None:
    """Refuse to go on without tslearn.

    Raises:
        PlatformError: It is missing.
    """
    if find_spec("tslearn") is None:
        raise PlatformError("--align dtw needs tslearn: pip install 'ifo[align]', or give --align none")


def common_index(sequences: np.ndarray) -> np.ndarray:
    """Frames that bring each sequence to the tempo that all have in common.

    Args:
        sequences: Features of n videos, comparable between videos, (n, T, D).

    Returns:
        Fractional frame indices (n, T), from 0, never falling: sequence i at `index[i, t]` shows what the soft-DTW
        barycentre shows at time t.

    Raises:
        PlatformError: tslearn is missing.
    """
    require_tslearn()
    from tslearn.barycenters import softdtw_barycenter
    from tslearn.metrics import soft_dtw_alignment

    scaled = _scaled(sequences)
    if scaled.shape[2] == 0:  # Nothing moves, or nothing that can be compared: equal times.
        return np.tile(np.arange(scaled.shape[1], dtype=np.float64), (len(scaled), 1))
    times = np.arange(scaled.shape[1])
    scaled = _with_clock(scaled, times)
    few = scaled[np.linspace(0, len(scaled) - 1, min(REFERENCES, len(scaled))).astype(int)]
    # From the most typical sequence, not from their mean: a mean over many tempos is a blur that none goes through.
    typical = few[np.square(few - few.mean(axis=0)).sum(axis=(1, 2)).argmin()]
    centre = softdtw_barycenter(list(few), gamma=SMOOTHING, init=typical, max_iter=ROUNDS)
    index = np.empty(scaled.shape[:2])
    for k, sequence in enumerate(scaled):
        path, _ = soft_dtw_alignment(sequence, centre, gamma=SMOOTHING)
        index[k] = (path * times[:, None]).sum(axis=0) / path.sum(axis=0).clip(1e-12)
    index[:, 0] = 0.0  # The context frame stays the first.
    return np.maximum.accumulate(index, axis=1)


def _scaled(sequences: np.ndarray) -> np.ndarray:
    """Sequences (n, T, D) whose mean squared distance between two frames is one, in the directions they move in."""
    covariance = np.zeros((sequences.shape[2], sequences.shape[2]))
    for start in range(0, len(sequences), CHUNK):  # Not all at once: a copy of many videos' features is large.
        part = sequences[start : start + CHUNK]
        moved = (part - part.mean(axis=1, keepdims=True)).reshape(-1, sequences.shape[2]).astype(np.float64)
        covariance += moved.T @ moved
    covariance /= sequences.shape[0] * sequences.shape[1]
    if not np.isfinite(covariance).all():
        return np.zeros((*sequences.shape[:2], 0))
    # A few directions hold what moves; soft-DTW's cost grows with their number.
    values, directions = np.linalg.eigh(covariance)
    kept = directions[:, values > max(values[-1] * 1e-3, 1e-12)][:, -16:]
    # From the first frame on: what a translation keeps of its source's context is no matter of time.
    projected = (sequences - sequences[:, :1]) @ kept.astype(sequences.dtype)
    return projected.astype(np.float64) / np.sqrt(max(2 * values.sum(), 1e-12))


def _with_clock(scaled: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Sequences (n, T, D) with the time as one more feature (n, T, D + 1), so that they are not warped for nothing.

    Being off by d frames costs what it is unlikely: noise * (d / EARLY_OR_LATE)^2, with noise being how much the last
    frames differ, which all show the end. In jittered videos of reach, frames of the swing that were .63 frames apart
    at equal times ended 1.1 apart without this, and .52 with it.
    """
    last = scaled[:, -1] - scaled[:, -1].mean(axis=0)
    weight = np.sqrt(np.square(last).sum(axis=1).mean()) / EARLY_OR_LATE
    return np.concatenate([scaled, np.broadcast_to(weight * times[None, :, None], (*scaled.shape[:2], 1))], axis=2)


def at_index(values: Tensor, index: np.ndarray) -> Tensor:
    """Values (n, T, ...) at fractional times (n, T), interpolated between neighbours."""
    low = np.floor(index).astype(np.int64).clip(0, values.shape[1] - 1)
    high = (low + 1).clip(0, values.shape[1] - 1)
    share = torch.from_numpy(index - low).to(values.dtype)
    rows = torch.arange(len(values))[:, None]
    share = share.reshape(*share.shape, *[1] * (values.ndim - 2))
    return values[rows, torch.from_numpy(low)] * (1 - share) + values[rows, torch.from_numpy(high)] * share


@torch.no_grad()
def video_index(model: Translator, frames: Tensor, reference: Tensor, device: str) -> np.ndarray:
    """The frames of each video that bring all to one tempo, by their translations into one context.

    Args:
        frames: Videos (N, T, H, W, 3), uint8.
        reference: The context frame (H, W, 3), uint8.

    Returns:
        Whole frame indices (N, T).
    """
    features = []
    with evaluating(model):
        context = model.encode_context(to_images(reference[None].to(device)))
        for start in range(0, len(frames), CHUNK):
            videos = frames[start : start + CHUNK]
            z3 = model.translate(model.encode(to_images(videos.flatten(0, 1).to(device))), context)
            features.append(z3.unflatten(0, videos.shape[:2]).cpu().numpy())
    return np.rint(common_index(np.concatenate(features))).astype(np.int64)
