"""Discriminators of GAIL and third-person imitation learning (TPIL) on images.

Their encoders are as large as the encoder of the translator, so that the comparison with these baselines is fair.
Spectral normalization keeps the discriminators smooth. Without it, an image discriminator soon separates all learner
frames from all expert frames, and its reward becomes uninformative.
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
    """Encoder of images (B, C, H, W) to features (B, 256): Enc1 of the compact translator, spectrally normalized."""

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
    """Gradient reversal: identity whose gradient is multiplied by -1 (Ganin and Lempitsky, 2015)."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        return x.view_as(x)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        return -gradients[0]


class GailDiscriminator(nn.Module):
    """GAIL's classifier of pairs of frames as expert or learner; its encoder observes both frames together."""

    def __init__(self, size: tuple[int, int]):
        super().__init__()
        self.encoder = Encoder(6, size)
        self.expert = spectral_norm(nn.Linear(FEATURES, 1))

    def forward(self, before: Tensor, after: Tensor) -> Tensor:
        """Logits (B,) that pairs of frames (B, 3, H, W) are the expert's."""
        return self.expert(self.encoder(torch.cat([before, after], dim=1)))[:, 0]


class TpilDiscriminator(nn.Module):
    """TPIL's classifier of pairs of frames as expert or not, from features that are invariant to the context."""

    def __init__(self, size: tuple[int, int], hidden: int = 128):
        super().__init__()
        self.encoder = Encoder(3, size)
        self.expert = nn.Sequential(
            spectral_norm(nn.Linear(2 * FEATURES, hidden)), nn.LeakyReLU(LEAK), spectral_norm(nn.Linear(hidden, 1))
        )
        self.domain = nn.Sequential(nn.Linear(FEATURES, hidden), nn.LeakyReLU(LEAK), nn.Linear(hidden, 1))

    def forward(self, before: Tensor, after: Tensor) -> Tensor:
        """Logits (B,) that pairs of frames (B, 3, H, W) are the expert's."""
        return self.expert(torch.cat([self.encoder(before), self.encoder(after)], dim=1))[:, 0]

    def both(self, before: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (B,) that pairs are the expert's, and (2B,) that single frames are from the learner's context.

        The gradient of the latter is reversed before the encoder, which thus learns to remove the context.
        """
        features = self.encoder(torch.cat([before, after]))
        one, other = features.chunk(2)
        expert = self.expert(torch.cat([one, other], dim=1))[:, 0]
        return expert, self.domain(_Reversal.apply(features))[:, 0]


def expert_loss(logits: Tensor, experts: int) -> Tensor:
    """Binary cross-entropy of logits (B,), of which the first `experts` are the expert's; classes weigh equally."""
    own, others = F.softplus(-logits[:experts]).mean(), F.softplus(logits[experts:]).mean()
    return 0.5 * (own + others)


def frozen(model: nn.Module) -> nn.Module:
    """Copy a discriminator for evaluation: spectral norms are not updated, and no gradients are stored."""
    return copy.deepcopy(model).eval().requires_grad_(False)
