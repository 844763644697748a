"""Quality metrics of translated images and features."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

SSIM_WINDOW, SSIM_SIGMA = 11, 1.5  # as in Wang et al. (2004)
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2


def squared_error(images: Tensor, truth: Tensor) -> Tensor:
    """Sum of squared differences per frame, scaled to pixels in [0, 1]: images (..., 3, H, W) in [-1, 1] -> (...)."""
    return (images - truth).square().sum(dim=(-3, -2, -1)) / 4.0


def psnr(images: Tensor, truth: Tensor) -> Tensor:
    """Peak signal-to-noise ratio per frame in dB, at most 100 dB: images (..., 3, H, W) in [-1, 1] -> (...)."""
    error = (images.clamp(-1, 1) - truth).square().mean(dim=(-3, -2, -1)) / 4.0
    return -10.0 * torch.log10(error.clamp_min(1e-10))


def ssim(images: Tensor, truth: Tensor) -> Tensor:
    """Structural similarity per frame, averaged over color channels: images (B, 3, H, W) in [-1, 1] -> (B,)."""
    x, y = (images.clamp(-1, 1) + 1) / 2, (truth + 1) / 2
    offsets = torch.arange(SSIM_WINDOW, dtype=x.dtype, device=x.device) - SSIM_WINDOW // 2
    line = torch.exp(-offsets.square() / (2 * SSIM_SIGMA**2))
    window = torch.outer(line, line) / line.sum() ** 2
    kernel = window.expand(3, 1, -1, -1)

    def blur(image: Tensor) -> Tensor:
        return F.conv2d(image, kernel, groups=3)

    mean_x, mean_y = blur(x), blur(y)
    variance_x, variance_y = blur(x * x) - mean_x**2, blur(y * y) - mean_y**2
    covariance = blur(x * y) - mean_x * mean_y
    likeness = (2 * mean_x * mean_y + SSIM_C1) * (2 * covariance + SSIM_C2)
    return (likeness / ((mean_x**2 + mean_y**2 + SSIM_C1) * (variance_x + variance_y + SSIM_C2))).mean(dim=(1, 2, 3))


def feature_ratio(target: Tensor, truth: Tensor) -> Tensor:
    """Error of a feature target, divided by the motion of the features along the true video.

    Below one, tracking the target leads towards the true video. At one, the target is no better than standing still.

    Args:
        target: Mean translated features (..., T, D).
        truth: Features Enc1(o_t) of the frames of the true video (..., T, D).

    Returns:
        Ratios (...).
    """
    motion = (truth - truth[..., :1, :]).square().sum(dim=(-2, -1))
    return (target - truth).square().sum(dim=(-2, -1)) / motion.clamp_min(1e-12)
