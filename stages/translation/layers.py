"""Layers of the translators. Batches have P pairs with K frames each; the context is encoded once per pair."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
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


class _ShuffledConvTranspose2d(torch.autograd.Function):
    """A transposed convolution with a kernel of twice the stride: a faster forward pass, the usual backward pass.

    Each block of stride x stride output pixels depends on 2x2 input pixels. The forward pass is therefore a 2x2
    convolution to stride^2 channels per output channel, and a pixel shuffle. On CPUs, a transposed convolution to few
    channels takes about 1.5 times as long (results/LOG.md, "Both cores, and fewer operations").
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None, stride: int) -> Tensor:
        """Map x (B, C, h, w) with weights (C, O, 2 s, 2 s) and biases (O,) to (B, O, s h, s w)."""
        ctx.save_for_backward(x, weight)
        ctx.stride, ctx.biases = stride, None if bias is None else [len(bias)]
        taps = weight.unflatten(3, (2, stride)).unflatten(2, (2, stride)).flip(2, 4)  # (C, O, 2, s, 2, s)
        biases = None if bias is None else bias.repeat_interleave(stride**2)
        blocks = F.conv2d(x, taps.permute(1, 3, 5, 0, 2, 4).flatten(0, 2), biases, padding=1)
        edge = slice(stride // 2, -(stride // 2))
        return F.pixel_shuffle(blocks, stride)[..., edge, edge]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, Tensor | None, Tensor | None, None]:
        x, weight = ctx.saved_tensors
        stride, padding = [ctx.stride] * 2, [ctx.stride // 2] * 2
        found = torch.ops.aten.convolution_backward(
            *gradients, x, weight, ctx.biases, stride, padding, [1, 1], True, [0, 0], 1, list(ctx.needs_input_grad[:3])
        )
        return *found, None


def conv_transpose(x: Tensor, weight: Tensor, bias: Tensor | None, stride: int, size: tuple[int, int]) -> Tensor:
    """Transposed convolution of x (B, C, h, w) with weights (C, O, k, k) and biases (O,) to outputs (B, O, *size).

    Inputs are padded as for outputs of size `stride` times (h, w), and the outputs are cropped or extended to `size`.
    """
    kernel = weight.shape[-1]
    whole = all(wanted == stride * side for wanted, side in zip(size, x.shape[2:], strict=True))
    if whole and kernel == 2 * stride >= 8 and stride % 2 == 0 and x.device.type == "cpu":
        return _ShuffledConvTranspose2d.apply(x, weight, bias, stride)
    padding = (kernel - stride + 1) // 2
    extra = [size[k] - ((x.shape[2 + k] - 1) * stride - 2 * padding + kernel) for k in range(2)]
    y = F.conv_transpose2d(x, weight, bias, stride, padding, [max(e, 0) for e in extra])
    return y[..., : size[0], : size[1]]


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
        y = conv_transpose(x, self.weight[: self.split], self.bias, self.stride[0], size)
        shared = conv_transpose(skip, self.weight[self.split :], None, self.stride[0], size)
        return (y.unflatten(0, (len(skip), -1)) + shared[:, None]).flatten(0, 1)

    def forward_joined(self, x: Tensor, skip: Tensor, size: tuple[int, int]) -> Tensor:
        """Plain form, which repeats the skip for each frame and concatenates it; for tests and benchmarks."""
        joined = torch.cat([x, skip.repeat_interleave(len(x) // len(skip), dim=0)], dim=1)
        return conv_transpose(joined, self.weight, self.bias, self.stride[0], size)


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
