"""Layers that are computed in a faster form equal the plain form, values and gradients."""

import pytest
import torch
from torch.nn import functional as F

from stages.translation.layers import conv_transpose
from stages.translation.networks import make_translator


def tensors(*shapes: tuple[int, ...]) -> list[torch.Tensor]:
    torch.manual_seed(4)
    return [torch.randn(shape, dtype=torch.float64, requires_grad=True) for shape in shapes]


@pytest.mark.parametrize(
    ("kernel", "stride", "grid", "size"),
    [
        (8, 4, (3, 5), (12, 20)),
        (8, 4, (3, 5), (11, 20)),
        (4, 2, (3, 3), (6, 6)),
        (5, 2, (3, 2), (6, 4)),
        (5, 1, (4, 4), (4, 4)),
    ],
)
@pytest.mark.parametrize("biased", [True, False])
def test_a_transposed_convolution_of_any_kernel_is_torchs(kernel, stride, grid, size, biased):
    x, weight, bias, gradient = tensors((2, 3, *grid), (3, 4, kernel, kernel), (4,), (2, 4, *size))
    chosen = [x, weight, bias] if biased else [x, weight]
    y = conv_transpose(x, weight, bias if biased else None, stride, size)
    padding = (kernel - stride + 1) // 2
    extra = 1 if kernel % 2 and stride == 2 else 0
    plain = F.conv_transpose2d(x, weight, bias if biased else None, stride, padding, extra)[..., : size[0], : size[1]]
    torch.testing.assert_close(y, plain)
    found = torch.autograd.grad((y * gradient).sum(), chosen)
    for ours, wanted in zip(found, torch.autograd.grad((plain * gradient).sum(), chosen), strict=True):
        torch.testing.assert_close(ours, wanted)


@pytest.mark.parametrize("arch", ["compact", "paper", "real"])
def test_encoding_images_and_contexts_together_changes_nothing(arch):
    torch.manual_seed(1)
    model = make_translator(arch, (16, 16)).eval().double()
    images, contexts = torch.rand(6, 3, 16, 16).double(), torch.rand(2, 3, 16, 16).double()
    features, context = model.encode_all(images, contexts)
    separate = model.encode_context(contexts)
    torch.testing.assert_close(features, model.encode(images))
    torch.testing.assert_close(context.features, separate.features)
    for ours, wanted in zip(context.skips, separate.skips, strict=True):
        torch.testing.assert_close(ours, wanted)
    assert torch.equal(context.image, contexts)
    if separate.palette is not None:
        torch.testing.assert_close(context.palette, separate.palette)


def test_a_pixel_is_a_mixture_of_its_context_and_the_palette_plus_a_correction():
    torch.manual_seed(2)
    model = make_translator("compact", (16, 16)).double()
    context = model.encode_context(torch.rand(2, 3, 16, 16).double())
    raw = torch.randn(4, 8, 16, 16).double()
    model._upsample = lambda layer, x, skip, size: raw if layer is model.dec_fine else x.new_zeros(len(x), 64, *size)
    images = model.decode(torch.rand(4, 256).double(), context)
    shares = torch.softmax(raw[:, :5], dim=1)
    for k in range(4):
        colors = torch.cat(
            [context.image[k // 2][None], context.palette[k // 2][:, :, None, None].expand(-1, -1, 16, 16)]
        )
        torch.testing.assert_close(images[k], (shares[k][:, None] * colors).sum(0) + raw[k, 5:])
