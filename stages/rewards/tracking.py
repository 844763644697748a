"""The paper's reward: track the mean translated features and images (Sec. V.A).

R(o_t) = R_feat(o_t) + w_rec R_img(o_t), with
R_feat(o_t) = -|Enc1(o_t) - mean_i F(o_t^i, o_0)|^2 and R_img(o_t) = -|o_t - mean_i M(o_t^i, o_0)|^2.

The paper gives no scale, and sums over pixels run to thousands. Here each term is divided by how much the
demonstrations themselves move: the sum over a video of its squared distance from its first frame, averaged over the
demonstrations. An episode that stands still returns about -1 a term (of R_img with blur: -2, for it has two), one that
follows the target about 0.

R_img as the paper has it is flat wherever the robot's image does not overlap the target's: an arm two pixels wide that
is five pixels off is as wrong as one on the other side of the table. So R_img here adds the same distance between
images blurred by a few pixels, which grows with how far off the robot is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import torch
from torch import Tensor

from artifacts import Artifact
from stages.translation.networks import Translator, to_images

LEAST_MOTION = 0.003  # of what moves without blur: what a blurred target's own motion is taken to be at least


@dataclass(frozen=True)
class TrackingTarget:
    """What to track.

    Attributes:
        features: Mean translated features (T, D).
        images: Mean translated images (T, 3, H, W), in [-1, 1].
        feature_scale: What R_feat is divided by.
        image_scale: What R_img is divided by.
        blur: Standard deviation, in pixels, of the Gaussian that R_img also compares images under; none below .1.
    """

    features: Tensor
    images: Tensor
    feature_scale: float
    image_scale: float
    blur: float = 0.0

    @classmethod
    def of(
        cls, source: Artifact | dict[str, np.ndarray], blur: float, device: str = "cpu", expert: bool = False
    ) -> TrackingTarget:
        """The target that a `translation` artifact, or its arrays, hold.

        Args:
            source: The artifact.
            blur: As above.
            device: Torch device.
            expert: Track the expert's own video in the context, a perfect translation, which must be there.
        """
        features = torch.from_numpy(source["expert_features" if expert else "target_features"])
        if expert:
            images = to_images(torch.from_numpy(source["expert_frames"]))
        else:
            images = torch.from_numpy(source["target_images"]).movedim(-1, 1) / 127.5 - 1
        scales = float(source["feature_scale"]), float(source["image_scale"])
        return cls(features.to(device), images.to(device), *scales, blur)

    @property
    def blurs(self) -> bool:
        """Whether R_img compares blurred images, too."""
        return self.blur >= 0.1

    @cached_property
    def _blurred(self) -> tuple[Tensor, float]:
        """The blurred images (T, 3, H, W), and how much they move; a target that stands still is given a little."""
        blurred = gaussian(self.images, self.blur)
        return blurred, max(float(motion(blurred[None])), LEAST_MOTION * self.image_scale)

    def feature_error(self, features: Tensor, frames: int | Tensor) -> Tensor:
        """Squared distances (B,) of features (B, D) from the target's at the index or indices `frames`, scaled."""
        return (features - self.features[frames]).square().sum(dim=1) / self.feature_scale

    def image_parts(self, images: Tensor) -> list[Tensor]:
        """What `image_error` compares of images (B, 3, H, W): and with `blur` blurred ones, over scales' roots."""
        parts = [images / self.image_scale**0.5]
        if self.blurs:
            parts.append(gaussian(images, self.blur) / self._blurred[1] ** 0.5)
        return parts

    def image_error(self, images: Tensor, frames: int | Tensor) -> Tensor:
        """Squared distances (B,) of images (B, 3, H, W) from the target's, scaled; with `blur`, of blurred ones too."""
        error = (images - self.images[frames]).square().sum(dim=(1, 2, 3)) / self.image_scale
        if self.blurs:
            blurred, scale = self._blurred
            error = error + (gaussian(images, self.blur) - blurred[frames]).square().sum(dim=(1, 2, 3)) / scale
        return error


def gaussian(images: Tensor, sigma: float) -> Tensor:
    """Images (B, C, H, W) under a Gaussian of `sigma` pixels; borders are continued."""
    height, width = (_blurring(size, sigma).to(images) for size in images.shape[-2:])
    return height @ images @ width.T


@lru_cache(maxsize=8)
def _blurring(size: int, sigma: float) -> Tensor:
    """What a line of `size` pixels is multiplied by: at these sizes eight times as fast as a convolution."""
    radius = math.ceil(3 * sigma)
    offsets = torch.arange(-radius, radius + 1)
    kernel = torch.exp(-offsets.double().square() / (2 * sigma**2))
    sources = (torch.arange(size)[:, None] + offsets).clamp(0, size - 1)
    matrix = torch.zeros(size, size, dtype=torch.float64)
    return matrix.scatter_add_(1, sources, (kernel / kernel.sum()).expand(size, -1))


def motion(values: Tensor) -> Tensor:
    """Squared distance from the first frame, summed over time: videos or their features (N, T, ...) -> (N,)."""
    return (values - values[:, :1]).square().flatten(1).sum(dim=1)


@dataclass(frozen=True)
class TrackingReward:
    """The reward of single frames.

    Attributes:
        model: The network whose Enc1 makes the features.
        target: What to track.
        weights: Weight (T,) of each frame's reward.
        image_weight: w_rec.
        without: Terms that are switched off, of `feat` and `img`.
        device: Torch device of the model and the target.
    """

    model: Translator
    target: TrackingTarget
    weights: np.ndarray
    image_weight: float = 1.0
    without: tuple[str, ...] = ()
    device: str = "cpu"

    @property
    def terms(self) -> tuple[str, ...]:
        """The terms that are not switched off."""
        return tuple(term for term in ("feat", "img") if term not in self.without)

    @torch.no_grad()
    def __call__(self, images: np.ndarray, frame: int) -> dict[str, np.ndarray]:
        """Each term's weighted reward (n,) of images (n, H, W, 3), uint8, at the frame index `frame`."""
        shown = to_images(torch.from_numpy(images).to(self.device))
        weight = float(self.weights[frame])
        rewards = {}
        if "feat" in self.terms:
            rewards["feat"] = -weight * self.target.feature_error(self.model.encode(shown), frame)
        if "img" in self.terms:
            rewards["img"] = -weight * self.image_weight * self.target.image_error(shown, frame)
        return {term: reward.double().cpu().numpy() for term, reward in rewards.items()}
