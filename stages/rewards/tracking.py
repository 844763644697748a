"""The paper's reward for tracking the mean translated features and images (Sec. V.A).

R(o_t) = R_feat(o_t) + w_rec R_img(o_t), with
R_feat(o_t) = -|Enc1(o_t) - mean_i F(o_t^i, o_0)|^2 and R_img(o_t) = -|o_t - mean_i M(o_t^i, o_0)|^2.

The paper specifies no scale, and sums over pixels are in the thousands. Here, each term is divided by the motion of the
demonstrations: squared distances from the first frame, summed over a video and averaged over the demonstrations. An
episode that stands still has a return of about -1 per term (-2 for R_img with blur, which consists of two distances).
An episode that follows the target has a return of about 0.

The paper's R_img is constant wherever the robot's image does not overlap the target's. For example, an arm that is two
pixels wide and five pixels off gets the same reward as an arm on the other side of the table. Therefore, R_img here
also includes the same distance between images blurred by a few pixels, which increases with the robot's distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import torch
from torch import Tensor

from artifacts import Artifact, ArtifactError
from stages.translation.networks import Translator, to_images

LEAST_MOTION = 0.003  # minimum scale for blurred images, relative to the scale without blur


@dataclass(frozen=True)
class TrackingTarget:
    """Target of the tracking reward.

    Attributes:
        features: Mean translated features (T, D).
        images: Mean translated images (T, 3, H, W), in [-1, 1].
        feature_scale: Divisor of R_feat.
        image_scale: Divisor of R_img.
        blur: Standard deviation, in pixels, of the Gaussian blur under which R_img also compares images; below 0.1,
            R_img does not compare blurred images.
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
        """Load the target from a `translation` artifact.

        Args:
            source: The artifact, or its arrays by name.
            blur: Standard deviation of the Gaussian blur, in pixels.
            device: Torch device.
            expert: Whether to track the expert's video in this context, as a perfect translation; the artifact must
                contain it.
        """
        features = torch.from_numpy(np.asarray(source["expert_features" if expert else "target_features"], np.float32))
        if expert:
            images = to_images(torch.from_numpy(source["expert_frames"]))
        else:
            images = torch.from_numpy(np.asarray(source["target_images"], np.float32)).movedim(-1, 1) / 127.5 - 1
        scales = float(source["feature_scale"]), float(source["image_scale"])
        if isinstance(source, Artifact) and not min(scales) > 0:
            raise ArtifactError(
                f"{source.path}: its demonstrations do not move (feature_scale {scales[0]:g}, image_scale "
                f"{scales[1]:g}), so there is nothing to track: collect or import others"
            )
        return cls(features.to(device), images.to(device), *scales, blur)

    @property
    def blurs(self) -> bool:
        """Whether R_img also compares blurred images."""
        return self.blur >= 0.1

    @cached_property
    def _blurred(self) -> tuple[Tensor, float]:
        """Blurred images (T, 3, H, W) and their motion, with a lower limit for targets that hardly move."""
        blurred = gaussian(self.images, self.blur)
        return blurred, max(float(motion(blurred[None])), LEAST_MOTION * self.image_scale)

    def feature_error(self, features: Tensor, frames: int | Tensor) -> Tensor:
        """Scaled squared distances (B,) of features (B, D) from the target at the frame index or indices `frames`."""
        return (features - self.features[frames]).square().sum(dim=1) / self.feature_scale

    def image_parts(self, images: Tensor) -> list[Tensor]:
        """Images (B, 3, H, W) and, with `blur`, blurred images, divided by the square roots of their scales.

        Squared distances between these parts sum to `image_error`.
        """
        parts = [images / self.image_scale**0.5]
        if self.blurs:
            parts.append(gaussian(images, self.blur) / self._blurred[1] ** 0.5)
        return parts

    def image_error(self, images: Tensor, frames: int | Tensor) -> Tensor:
        """Scaled squared distances (B,) of images (B, 3, H, W) from the target; with `blur`, plus those under blur."""
        error = (images - self.images[frames]).square().sum(dim=(1, 2, 3)) / self.image_scale
        if self.blurs:
            blurred, scale = self._blurred
            error = error + (gaussian(images, self.blur) - blurred[frames]).square().sum(dim=(1, 2, 3)) / scale
        return error


def gaussian(images: Tensor, sigma: float) -> Tensor:
    """Blur images (B, C, H, W) with a Gaussian of standard deviation `sigma` pixels; border pixels are repeated."""
    height, width = (_blurring(size, sigma).to(images) for size in images.shape[-2:])
    return height @ images @ width.T


@lru_cache(maxsize=8)
def _blurring(size: int, sigma: float) -> Tensor:
    """Matrix that blurs a line of `size` pixels; at these sizes, it is eight times as fast as a convolution."""
    radius = math.ceil(3 * sigma)
    offsets = torch.arange(-radius, radius + 1)
    kernel = torch.exp(-offsets.double().square() / (2 * sigma**2))
    sources = (torch.arange(size)[:, None] + offsets).clamp(0, size - 1)
    matrix = torch.zeros(size, size, dtype=torch.float64)
    return matrix.scatter_add_(1, sources, (kernel / kernel.sum()).expand(size, -1))


def motion(values: Tensor) -> Tensor:
    """Squared distances (N,) from the first frame, summed over time, of videos or features (N, T, ...)."""
    return (values - values[:, :1]).square().flatten(1).sum(dim=1)


@dataclass(frozen=True)
class TrackingReward:
    """The reward for single frames.

    Attributes:
        model: Network whose Enc1 computes the features.
        target: Target to track.
        weights: Weights (T,) of the frames.
        image_weight: Weight w_rec of R_img.
        without: Terms that are switched off: `feat` or `img`.
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
        """Active terms of the reward."""
        return tuple(term for term in ("feat", "img") if term not in self.without)

    @torch.no_grad()
    def __call__(self, images: np.ndarray, frame: int) -> dict[str, np.ndarray]:
        """Weighted rewards (n,) by term for images (n, H, W, 3), uint8, at frame index `frame`."""
        shown = to_images(torch.from_numpy(images).to(self.device))
        weight = float(self.weights[frame])
        rewards = {}
        if "feat" in self.terms:
            rewards["feat"] = -weight * self.target.feature_error(self.model.encode(shown), frame)
        if "img" in self.terms:
            rewards["img"] = -weight * self.image_weight * self.target.image_error(shown, frame)
        return {term: reward.double().cpu().numpy() for term, reward in rewards.items()}
