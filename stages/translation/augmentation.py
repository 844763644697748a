"""Random augmentation of training videos, for small sets of videos: changes of lighting and color, and of the camera.

All frames of a video, including its context frame, get the same change. Otherwise, differences from the context frame
would no longer show only motion. The paper uses no augmentation: it has about a hundred real videos per task (Sec.
VI.A), and dropout.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

# Bounds of the changes, which are drawn uniformly and independently (results/LOG.md, "Few videos").
BRIGHTNESS = 0.15  # maximum offset; pixels are in [-1, 1]
CONTRAST = 0.15  # maximum deviation from one of the factor for distances from the context frame's mean
SATURATION = 0.2  # maximum deviation from one of the factor for distances of a color from its gray
ROTATION = 30.0  # maximum angle about the middle of the frame, degrees
ZOOM = 0.2  # maximum absolute logarithm of the magnification
SHIFT = 0.12  # maximum shift as a share of height and width: 6 of 48 pixels
LUMA = (0.299, 0.587, 0.114)  # luma coefficients of red, green and blue (ITU-R BT.601)


def augmented(images: Tensor, rng: np.random.Generator) -> Tensor:
    """Change brightness, contrast and saturation of videos; rotate, magnify and shift them.

    Args:
        images: Frames (V, F, 3, H, W) of V videos, in [-1, 1]; the first frame of each video is its context frame.
        rng: Generator for the changes, which are drawn once per video.

    Returns:
        Frames of the same shape, in [-1, 1]. Outside the original frames, the border pixels are repeated.
    """
    videos = len(images)

    def drawn(bound: float, around: float = 0.0) -> Tensor:
        values = rng.uniform(around - bound, around + bound, videos)
        return torch.from_numpy(values).to(images, non_blocking=True)

    def each(values: Tensor) -> Tensor:
        return values[:, None, None, None, None]

    brightness, contrast, saturation = drawn(BRIGHTNESS), drawn(CONTRAST, 1.0), drawn(SATURATION, 1.0)
    grey = (images * images.new_tensor(LUMA)[:, None, None]).sum(dim=2, keepdim=True)
    mean = grey[:, :1].mean(dim=(3, 4), keepdim=True)
    coloured = grey + each(saturation) * (images - grey)
    changed = (mean + each(contrast) * (coloured - mean) + each(brightness)).clamp(-1, 1)
    return _moved(changed, drawn(math.radians(ROTATION)), drawn(ZOOM).exp(), drawn(SHIFT), drawn(SHIFT))


def _moved(images: Tensor, angle: Tensor, magnification: Tensor, right: Tensor, down: Tensor) -> Tensor:
    """Rotate videos clockwise by angles (V,) in radians, magnify them, and shift them by shares of width and height."""
    height, width = images.shape[-2:]
    # The sampling grid is in units of half the width and half the height, and maps positions of the result to positions
    # of the original.
    cos, sin = angle.cos() / magnification, angle.sin() / magnification
    across = torch.stack([cos, sin * (height / width)], dim=1)
    along = torch.stack([-sin * (width / height), cos], dim=1)
    matrix = torch.stack([across, along], dim=1)
    shift = torch.stack([right, down], dim=1)[:, :, None] * 2
    grid = F.affine_grid(
        torch.cat([matrix, -matrix @ shift], dim=2), [len(images), 1, height, width], align_corners=False
    )
    stacked = images.flatten(1, 2)
    return F.grid_sample(stacked, grid, padding_mode="border", align_corners=False).view_as(images)
