"""Light random augmentation of training videos, for small sets of real videos: changes of lighting, color and position.

All frames of a video, including its context frame, get the same change. Otherwise, differences from the context frame
would no longer show only motion. The paper uses no augmentation: it has about a hundred real videos per task (Sec.
VI.A), and dropout.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

# Bounds of the changes, which are drawn uniformly and independently.
BRIGHTNESS = 0.15  # maximum offset; pixels are in [-1, 1]
CONTRAST = 0.15  # maximum deviation from one of the factor for distances from the context frame's mean
SATURATION = 0.2  # maximum deviation from one of the factor for distances of a color from its gray
SHIFT = 1 / 16  # maximum shift as a share of height and width: 3 of 48 pixels
LUMA = (0.299, 0.587, 0.114)  # luma coefficients of red, green and blue (ITU-R BT.601)


def augmented(images: Tensor, rng: np.random.Generator) -> Tensor:
    """Change brightness, contrast and saturation of videos, and shift them by a few whole pixels.

    Args:
        images: Frames (V, F, 3, H, W) of V videos, in [-1, 1]; the first frame of each video is its context frame.
        rng: Generator for the changes, which are drawn once per video.

    Returns:
        Frames of the same shape, in [-1, 1]. Shifted frames are padded by repeating the border pixels.
    """
    videos, size = len(images), images.shape[-2:]

    def drawn(bound: float, around: float = 0.0) -> Tensor:
        values = rng.uniform(around - bound, around + bound, videos)
        return torch.from_numpy(values).to(images, non_blocking=True)[:, None, None, None, None]

    brightness, contrast, saturation = drawn(BRIGHTNESS), drawn(CONTRAST, 1.0), drawn(SATURATION, 1.0)
    grey = (images * images.new_tensor(LUMA)[:, None, None]).sum(dim=2, keepdim=True)
    mean = grey[:, :1].mean(dim=(3, 4), keepdim=True)
    coloured = grey + saturation * (images - grey)
    changed = (mean + contrast * (coloured - mean) + brightness).clamp(-1, 1)
    for axis, pixels in zip((3, 4), size, strict=True):
        most = round(SHIFT * pixels)
        offsets = torch.from_numpy(rng.integers(-most, most, videos, endpoint=True))
        source = (torch.arange(pixels) - offsets[:, None]).clamp(0, pixels - 1).to(images.device)
        shape = [videos, 1, 1, 1, 1]
        shape[axis] = pixels
        changed = torch.take_along_dim(changed, source.reshape(shape), dim=axis)
    return changed
