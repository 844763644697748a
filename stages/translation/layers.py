"""Layers of the translators. Batches have P pairs with K frames each; the context is encoded once per pair."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

LEAK = 0.2


def he_initialise(module: nn.Module) -> None:
    """Apply He initialization with zero biases, in place.

    With PyTorch's defaults, the initial features are so small that L_align pulls them to zero before the decoder has
    learned to use them. The translator then collapses to copying its context.
    """
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
            if isinstance(layer, nn.ConvTranspose2d):
                # Each output pixel of a transposed convolution with stride s sums kernel^2 / s^2 taps per channel.
                taps = layer.kernel_size[0] * layer.kernel_size[1] / (layer.stride[0] * layer.stride[1])
                gain = nn.init.calculate_gain("leaky_relu", LEAK)
                nn.init.normal_(layer.weight, std=gain / (layer.in_channels * taps) ** 0.5)
            else:
                nn.init.kaiming_normal_(layer.weight, a=LEAK)
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)


class DropoutLinear(nn.Linear):
    """A fully connected layer with dropout of its inputs, with probability `dropout`, during training."""

    def __init__(self, inputs: int, outputs: int, dropout: float):
        super().__init__(inputs, outputs)
        self.dropout = dropout

    def forward(self, x: Tensor) -> Tensor:
        return super().forward(F.dropout(x, self.dropout, self.training) if self.dropout else x)


class SkipConvTranspose2d(nn.ConvTranspose2d):
    """A transposed convolution of the concatenation of its input and a skip connection from the context encoder.

    There is one input per frame, but only one skip per pair. Convolution is linear, so the contribution of the skip is
    computed once per pair and added to every frame. The result is the same, with fewer operations. With C and S
    channels of input and skip, a pair of K frames needs (K C + S) / (K (C + S)) of the operations of the plain form:
    five eighths for C = S, as in the paper's network, and K = 4.
    """

    def __init__(self, channels: int, skip_channels: int, out_channels: int, kernel: int, stride: int = 2):
        padding = (kernel - stride + 1) // 2
        super().__init__(channels + skip_channels, out_channels, kernel, stride=stride, padding=padding)
        self.split = channels

    def forward_split(self, x: Tensor, skip: Tensor, size: tuple[int, int]) -> Tensor:
        """Map inputs x (P * K, C, h, w) and skips (P, S, h, w) to outputs (P * K, O, *size)."""
        y = self._transposed(x, self.weight[: self.split], self.bias, size)
        shared = self._transposed(skip, self.weight[self.split :], None, size)
        return (y.unflatten(0, (len(skip), -1)) + shared[:, None]).flatten(0, 1)

    def forward_joined(self, x: Tensor, skip: Tensor, size: tuple[int, int]) -> Tensor:
        """Plain form, which repeats the skip for each frame and concatenates it; for tests and benchmarks."""
        joined = torch.cat([x, skip.repeat_interleave(len(x) // len(skip), dim=0)], dim=1)
        return self._transposed(joined, self.weight, self.bias, size)

    def _transposed(self, x: Tensor, weight: Tensor, bias: Tensor | None, size: tuple[int, int]) -> Tensor:
        """Transposed convolution with the output padding or cropping that gives an output of `size`."""
        stride, padding, kernel = self.stride[0], int(self.padding[0]), self.kernel_size[0]
        extra = [size[k] - ((x.shape[2 + k] - 1) * stride - 2 * padding + kernel) for k in range(2)]
        y = F.conv_transpose2d(x, weight, bias, stride, padding, [max(e, 0) for e in extra])
        return y[..., : size[0], : size[1]]


class ConvEncoder(nn.Module):
    """Convolutions with LeakyReLU; returns the activations of all layers, finest first."""

    def __init__(self, channels: tuple[int, ...], strides: tuple[int, ...], kernel: int, in_channels: int = 3):
        super().__init__()
        widths = pairwise((in_channels, *channels))
        self.layers = nn.ModuleList(
            nn.Conv2d(a, b, kernel, stride, padding=kernel // 2) for (a, b), stride in zip(widths, strides, strict=True)
        )

    def forward(self, x: Tensor) -> list[Tensor]:
        activations = []
        for layer in self.layers:
            x = F.leaky_relu(layer(x), LEAK)
            activations.append(x)
        return activations


def strided(size: tuple[int, int], strides: tuple[int, ...]) -> list[tuple[int, int]]:
    """Sizes of an image before and after each convolution with the given strides and "same" padding."""
    sizes = [size]
    for stride in strides:
        sizes.append((-(-sizes[-1][0] // stride), -(-sizes[-1][1] // stride)))
    return sizes


@contextmanager
def evaluating(model: nn.Module) -> Iterator[None]:
    """Context manager that puts `model` in evaluation mode (no dropout) and restores its mode afterwards."""
    training = model.training
    model.eval()
    try:
        yield
    finally:
        model.train(training)
