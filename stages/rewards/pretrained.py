"""The paper's baseline without translation: track features of a network that was trained on ImageNet (Sec. VI.B).

R(o_t) = -w_t / T mean_d ((phi_d(o_t) - mu_td) / sigma_td)^2, with mean mu and spread sigma over the demonstrations,
taken at the same time in their own contexts, and the ramp's weight w_t.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from artifacts import UsageError
from stages.rewards.frames import FrameReward, time_weights
from stages.rewards.networks import PretrainedNetwork
from stages.simulation.contexts import Contexts
from stages.simulation.render import RenderPool
from stages.simulation.task import Task
from stages.translation.networks import to_images

CHUNK = 50  # frames at a time
LEAST_SPREAD = 0.1  # of a layer's mean spread: what a feature that hardly varies is divided by at least
HELD_OUT = 0.25  # share of the demonstrations that layers are compared on


@dataclass(frozen=True)
class FeatureTrack:
    """What to track in one layer.

    Attributes:
        layer: Its name.
        mean: Features' mean over demonstrations (T, D).
        spread: Their standard deviation (T, D), floored.
        quality: Held-out error over held-out motion: below one, the target says more than standing still does.
    """

    layer: str
    mean: Tensor
    spread: Tensor
    quality: float

    def error(self, features: Tensor, frames: int | Tensor) -> Tensor:
        """Mean squared distances (B,) of features (B, D) from the track at frame indices, in spreads."""
        return ((features - self.mean[frames]) / self.spread[frames]).square().mean(dim=1)


def track(network: PretrainedNetwork, videos: np.ndarray, layer: str, device: str) -> FeatureTrack:
    """The track of `videos` (N, T, H, W, 3), uint8, in `layer`; "best": where it says most of videos held out.

    Raises:
        UsageError: The network has no such layer.
    """
    if layer != "best" and layer not in network.pieces:
        raise UsageError(f"--layer {layer}: {network.name} has best, {', '.join(network.pieces)}")
    collected: dict[str, list[Tensor]] = {}
    frames = videos.reshape(-1, *videos.shape[2:])
    up_to = "" if layer == "best" else layer
    for start in range(0, len(frames), CHUNK):
        images = to_images(torch.from_numpy(frames[start : start + CHUNK]).to(device))
        for name, features in network.features(images, up_to):
            collected.setdefault(name, []).append(features)
    layers = collected if layer == "best" else {layer: collected[layer]}
    tracks = [_track(name, torch.cat(parts).unflatten(0, videos.shape[:2])) for name, parts in layers.items()]
    return min(tracks, key=lambda made: made.quality)


def _track(layer: str, features: Tensor) -> FeatureTrack:
    """The track of all videos' features (N, T, D); its quality is that of one without the last quarter."""
    few = max(round(HELD_OUT * len(features)), 1)
    partial = _moments(layer, features[:-few], 0.0)
    held = features[-few:]
    times = torch.arange(features.shape[1])
    error = torch.stack([partial.error(video, times).sum() for video in held]).sum()
    moved = torch.stack([((video - video[0]) / partial.spread).square().mean(dim=1).sum() for video in held]).sum()
    return _moments(layer, features, float(error / moved.clamp_min(1e-9)))


def _moments(layer: str, features: Tensor, quality: float) -> FeatureTrack:
    spread = features.std(dim=0, correction=0)
    return FeatureTrack(layer, features.mean(dim=0), spread.clamp_min(LEAST_SPREAD * float(spread.mean())), quality)


def embedded_track(
    network: PretrainedNetwork, videos: np.ndarray, target: FeatureTrack, device: str
) -> tuple[Callable[[np.ndarray], np.ndarray], np.ndarray, np.ndarray]:
    """The tracking for a learner of quadratic costs: features over their spread, which is the mean over time here.

    Args:
        network: The network.
        videos: Demonstrations (N, T, H, W, 3), uint8.
        target: What is tracked.

    Returns:
        A function from frames (n, H, W, 3) to embeddings (n, E); embeddings of the target (T, E), and of frames (M, E).
    """
    scale = target.spread.mean(dim=0) * target.mean.numel() ** 0.5  # The return is a mean over features and frames.

    @torch.no_grad()
    def embed(frames: np.ndarray) -> np.ndarray:
        parts = []
        for start in range(0, len(frames), CHUNK):
            images = to_images(torch.from_numpy(frames[start : start + CHUNK]).to(device))
            *_, (_, features) = network.features(images, target.layer)
            parts.append((features / scale).double().cpu().numpy())
        return np.concatenate(parts)

    return embed, (target.mean / scale).double().cpu().numpy(), embed(videos.reshape(-1, *videos.shape[2:]))


class PretrainedReward(FrameReward):
    """Reward of n simulations in one fixed context: how near their frames' features stay to the track."""

    def __init__(
        self,
        task: Task,
        context: Contexts,
        pool: RenderPool,
        network: PretrainedNetwork,
        target: FeatureTrack,
        ramp: str = "none",
        device: str = "cpu",
    ):
        """Track `target` in features of `network`; `ramp` "quadratic" weights frame j by j^2, to a mean of one."""
        super().__init__(task, context, pool)
        self._network, self._target, self._device = network, target, device
        self._weights = time_weights(ramp, task.frames)

    @torch.no_grad()
    def judge(self, frame: int, drawn: np.ndarray) -> np.ndarray:
        errors = []
        for start in range(0, len(drawn), CHUNK):
            images = to_images(torch.from_numpy(drawn[start : start + CHUNK]).to(self._device))
            *_, (_, features) = self._network.features(images, self._target.layer)
            errors.append(self._target.error(features, frame))
        weight = float(self._weights[frame]) / self._task.frames
        return -weight * torch.cat(errors).double().cpu().numpy()
