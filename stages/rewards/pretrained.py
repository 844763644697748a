"""The paper's baseline without translation: tracking of features of a network pretrained on ImageNet (Sec. VI.B).

R(o_t) = -w_t / T mean_d ((phi_d(o_t) - mu_td) / sigma_td)^2, where mu and sigma are mean and standard deviation over
the demonstrations at the same time in their own contexts, and w_t is the weight of the ramp.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from artifacts import UsageError
from stages.environments.timing import Timing
from stages.rewards.frames import FrameReward, time_weights
from stages.rewards.networks import PretrainedNetwork
from stages.translation.networks import to_images

CHUNK = 50  # frames processed at once
LEAST_SPREAD = 0.1  # minimum spread of a feature, relative to the mean spread of its layer
HELD_OUT = 0.25  # share of the demonstrations held out for comparing layers


@dataclass(frozen=True)
class FeatureTrack:
    """Target of the tracking in one layer.

    Attributes:
        layer: Name of the layer.
        mean: Mean of the features over demonstrations (T, D).
        spread: Standard deviation of the features over demonstrations (T, D), with a lower limit.
        quality: Held-out tracking error divided by held-out motion; below one, the target is better than standing
            still.
    """

    layer: str
    mean: Tensor
    spread: Tensor
    quality: float

    def error(self, features: Tensor, frames: int | Tensor) -> Tensor:
        """Mean squared distances (B,) of features (B, D) from the track at frame indices, in units of the spread."""
        return ((features - self.mean[frames]) / self.spread[frames]).square().mean(dim=1)


def track(network: PretrainedNetwork, videos: np.ndarray, layer: str, device: str) -> FeatureTrack:
    """Compute the track of `videos` (N, T, H, W, 3), uint8, in `layer`.

    With "best", the layer is the one with the lowest held-out tracking error relative to held-out motion.

    Raises:
        UsageError: The network has no layer with this name.
    """
    if layer != "best" and layer not in network.pieces:
        raise UsageError(f"--layer {layer}: for {network.name}, expected best, {', '.join(network.pieces)}")
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
    """Track of the features (N, T, D) of all videos; its quality is measured by holding out the last quarter."""
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
    """Embeddings for learners with quadratic costs: features divided by their mean spread over time.

    Args:
        network: The network.
        videos: Demonstrations (N, T, H, W, 3), uint8.
        target: Track to embed.
        device: Torch device of the network.

    Returns:
        A function from frames (n, H, W, 3) to embeddings (n, E), the embeddings of the target (T, E), and the
        embeddings of all frames of the demonstrations (M, E).
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
    """Reward of n environments in one fixed context for frames whose features are close to the track."""

    def __init__(
        self,
        timing: Timing,
        network: PretrainedNetwork,
        target: FeatureTrack,
        ramp: str = "none",
        device: str = "cpu",
    ):
        """Track `target` in features of `network`; see `time_weights` for `ramp`."""
        super().__init__(timing)
        self._network, self._target, self._device = network, target, device
        self._weights = time_weights(ramp, timing.frames)

    @torch.no_grad()
    def judge(self, frame: int, drawn: np.ndarray) -> np.ndarray:
        errors = []
        for start in range(0, len(drawn), CHUNK):
            images = to_images(torch.from_numpy(drawn[start : start + CHUNK]).to(self._device))
            *_, (_, features) = self._network.features(images, self._target.layer)
            errors.append(self._target.error(features, frame))
        weight = float(self._weights[frame]) / self._timing.frames
        return -weight * torch.cat(errors).double().cpu().numpy()
