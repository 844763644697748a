"""Discriminators of GAIL and of third-person imitation learning (TPIL), on images.

Their encoders have the size of the translator's: a baseline is to lose for what it cannot know, not for being small.
Spectral norms keep them smooth, without which an image discriminator soon tells all of the learner's frames from all
of the expert's and its reward leads nowhere.
"""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.nn.utils.parametrizations import spectral_norm

from stages.translation.layers import LEAK

FEATURES = 256


class Encoder(nn.Sequential):
    """Images (B, C, H, W) -> features (B, 256): the compact translator's Enc1, under spectral norms."""

    def __init__(self, channels: int, size: tuple[int, int], fine: int = 64, coarse: int = 128):
        rows, columns = ((length // 4 + 1) // 2 for length in size)
        super().__init__(
            spectral_norm(nn.Conv2d(channels, fine, 6, stride=4, padding=1)),
            nn.LeakyReLU(LEAK),
            spectral_norm(nn.Conv2d(fine, coarse, 3, stride=2, padding=1)),
            nn.LeakyReLU(LEAK),
            nn.Flatten(),
            spectral_norm(nn.Linear(coarse * rows * columns, FEATURES)),
            nn.LeakyReLU(LEAK),
        )


class _Reversal(torch.autograd.Function):
    """The identity, whose gradient is turned round (Ganin and Lempitsky, 2015)."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        return x.view_as(x)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        return -gradients[0]


class GailDiscriminator(nn.Module):
    """Is this pair of frames the expert's? Sees both frames at once."""

    def __init__(self, size: tuple[int, int]):
        super().__init__()
        self.encoder = Encoder(6, size)
        self.expert = spectral_norm(nn.Linear(FEATURES, 1))

    def forward(self, before: Tensor, after: Tensor) -> Tensor:
        """Logits (B,) of pairs of frames (B, 3, H, W)."""
        return self.expert(self.encoder(torch.cat([before, after], dim=1)))[:, 0]


class TpilDiscriminator(nn.Module):
    """Is this pair of frames the expert's, told from features that do not tell whose context they are from?"""

    def __init__(self, size: tuple[int, int], hidden: int = 128):
        super().__init__()
        self.encoder = Encoder(3, size)
        self.expert = nn.Sequential(
            spectral_norm(nn.Linear(2 * FEATURES, hidden)), nn.LeakyReLU(LEAK), spectral_norm(nn.Linear(hidden, 1))
        )
        self.domain = nn.Sequential(nn.Linear(FEATURES, hidden), nn.LeakyReLU(LEAK), nn.Linear(hidden, 1))

    def forward(self, before: Tensor, after: Tensor) -> Tensor:
        """Logits (B,) of pairs of frames (B, 3, H, W) being the expert's."""
        return self.expert(torch.cat([self.encoder(before), self.encoder(after)], dim=1))[:, 0]

    def both(self, before: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (B,) of pairs being the expert's, and (2B,) of single frames being from the learner's context.

        The second's gradient is turned round on its way into the encoder, which so learns to hide the context.
        """
        features = self.encoder(torch.cat([before, after]))
        one, other = features.chunk(2)
        expert = self.expert(torch.cat([one, other], dim=1))[:, 0]
        return expert, self.domain(_Reversal.apply(features))[:, 0]


def expert_loss(logits: Tensor, experts: int) -> Tensor:
    """Binary cross-entropy of logits (B,) whose first `experts` are the expert's; both classes weigh the same."""
    own, others = F.softplus(-logits[:experts]).mean(), F.softplus(logits[experts:]).mean()
    return 0.5 * (own + others)


def frozen(model: nn.Module) -> nn.Module:
    """A copy for judging: spectral norms are taken as they stand, and no gradients are kept."""
    return copy.deepcopy(model).eval().requires_grad_(False)
