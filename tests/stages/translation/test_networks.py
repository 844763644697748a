"""The translators compute what the paper describes, in fewer operations than its plain form."""

import pytest
import torch
from torch import nn

from artifacts import ArtifactError
from stages.translation.losses import translation_losses
from stages.translation.networks import CompactTranslator, PaperTranslator, make_translator, to_frames, to_images

ARCHITECTURES = ("compact", "paper")
SIZES = ((48, 48), (36, 64))


@pytest.fixture(autouse=True)
def seeded():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        yield


def small(arch: str, size=(48, 48)):
    return PaperTranslator(size, feature_size=64) if arch == "paper" else CompactTranslator(size, 32, 8, 16, 32)


@pytest.mark.parametrize("arch", ARCHITECTURES)
@pytest.mark.parametrize("size", SIZES)
def test_shapes(arch, size):
    model = small(arch, size)
    context = model.encode_context(torch.rand(2, 3, *size))
    z1 = model.encode(torch.rand(6, 3, *size))
    assert z1.shape == (6, model.feature_size)
    z3 = model.translate(z1, context)
    assert z3.shape == z1.shape
    assert model.decode(z3, context).shape == (6, 3, *size)


def test_paper_network_has_the_papers_layers():
    model = PaperTranslator((48, 48))
    for encoder in (model.enc1, model.enc2):
        assert [(c.out_channels, c.kernel_size, c.stride) for c in encoder.layers] == [
            (width, (5, 5), (2, 2)) for width in (64, 128, 256, 512)
        ]
    assert model.enc1 is not model.enc2
    for head in (model.enc1_head, model.enc2_head):
        assert [layer.out_features for layer in head if isinstance(layer, nn.Linear)] == [1024, 1024]
    linear = [layer for layer in model.translation if isinstance(layer, nn.Linear)]
    assert [(layer.in_features, layer.out_features) for layer in linear] == [(2048, 1024), (1024, 1024)]
    # Each fractionally-strided convolution takes the layer before and Enc2's layer of the same size.
    assert [(c.in_channels, c.out_channels) for c in model.dec] == [(1024, 256), (512, 128), (256, 64), (128, 3)]


@pytest.mark.parametrize("arch", ARCHITECTURES)
@pytest.mark.parametrize("size", SIZES)
def test_computing_the_skips_once_a_pair_changes_neither_losses_nor_gradients(arch, size):
    model = small(arch, size).double()
    for parameter in model.parameters():  # T' of the compact network starts at zero: leave that special point
        parameter.data += 0.01 * torch.randn_like(parameter)
    videos = torch.rand(4, 3, 3, *size, dtype=torch.float64) * 2 - 1
    sources = [torch.tensor([1, 2, 3, 0]), torch.tensor([2, 3, 0, 1])]
    gradients = {}
    for plain in (False, True):
        model.plain = plain
        losses = translation_losses(model, videos[:, 1:], videos[:, 0], sources, motion_weight=0.5)
        gradients[plain] = torch.autograd.grad(sum(losses.values()), list(model.parameters()))
    for split, joined in zip(gradients[False], gradients[True], strict=True):
        torch.testing.assert_close(split, joined, rtol=1e-5, atol=1e-8)


def test_compact_translation_starts_at_the_contexts_own_features():
    model = make_translator("compact", (48, 48))
    frames = torch.rand(4, 3, 48, 48) * 2 - 1
    context = model.encode_context(frames)
    assert torch.equal(context.features, model.encode(frames)), "the encoders are tied"
    assert torch.equal(model.translate(model.encode(frames.flip(0)), context), context.features)


@pytest.mark.parametrize("arch", ARCHITECTURES)
def test_features_of_different_frames_differ_at_the_start(arch):
    model = make_translator(arch, (48, 48))
    features = model.encode(torch.rand(8, 3, 48, 48) * 2 - 1)
    assert features.std(dim=0).mean() > 0.05, "PyTorch's defaults start near zero, where L_align holds them"


def test_frame_sizes_that_do_not_fit_are_refused():
    with pytest.raises(ArtifactError, match="multiples of 4"):
        make_translator("compact", (50, 48))


def test_frames_and_images_convert_exactly():
    frames = torch.arange(256, dtype=torch.uint8).reshape(1, 8, 32, 1).expand(1, 8, 32, 3)
    images = to_images(frames)
    assert images.shape == (1, 3, 8, 32)
    assert images.min() == -1.0
    assert images.max() == 1.0
    assert torch.equal(to_frames(images), frames)
