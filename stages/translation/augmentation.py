"""Light random changes of training videos, for few real ones: other light, another camera, held a little differently.

A video is changed as a whole, its context frame included, or what differs between the two would no longer be what
happened. The paper has no such thing: it has a hundred real videos or so a task (Sec. VI.A), and dropout.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

# Bounds of what is drawn, uniformly and independently.
BRIGHTNESS = 0.15  # added, of the range [-1, 1]
CONTRAST = 0.15  # off a factor of one, of how far a pixel is from the context frame's mean
SATURATION = 0.2  # off a factor of one, of how far a colour is from its grey
SHIFT = 1 / 16  # of height and width: three pixels of 48
LUMA = (0.299, 0.587, 0.114)  # of red, green and blue (ITU-R BT.601)


def augmented(images: Tensor, rng: np.random.Generator) -> Tensor:
    """Videos in another light, and a few whole pixels aside.

    Args:
        images: Frames (V, F, 3, H, W) of V videos, in [-1, 1]; the first of each is its context frame.
        rng: What is drawn from it is drawn once a video, and the same for all of its frames.

    Returns:
        Frames of the same shape, in [-1, 1]; where nothing is known of what moved into the picture, its border goes on.
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
