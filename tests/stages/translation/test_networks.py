"""The translators compute what the paper describes, in fewer operations than its plain form."""

import numpy as np
import pytest
import torch
from torch import nn

from artifacts import ArtifactError, read_artifact, write_artifact
from stages.translation.layers import DropoutLinear, evaluating
from stages.translation.losses import translation_losses
from stages.translation.networks import (
    NETWORKS,
    CompactTranslator,
    PaperTranslator,
    RealTranslator,
    load_translator,
    make_translator,
    to_frames,
    to_images,
)

ARCHITECTURES = ("compact", "paper", "real")
SIZES = ((48, 48), (36, 64))


@pytest.fixture(autouse=True)
def seeded():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        yield


def small(arch: str, size=(48, 48)):
    if arch == "compact":
        return CompactTranslator(size, 32, 8, 16, 32)
    return RealTranslator(size) if arch == "real" else PaperTranslator(size, feature_size=64)


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


def test_real_network_has_the_papers_layers():
    model = RealTranslator((48, 48))
    assert [(c.out_channels, c.kernel_size, c.stride) for c in model.enc1.layers] == [
        (width, (5, 5), (stride, stride)) for width, stride in ((32, 1), (16, 2), (16, 1), (8, 2))
    ]
    # Each fractionally-strided convolution takes the layer before and Enc2's layer of the same size.
    assert [(c.in_channels, c.out_channels, c.stride[0]) for c in model.dec] == [
        (16, 16, 2),
        (32, 16, 1),
        (32, 32, 2),
        (64, 3, 1),
    ]
    assert [activation.shape[1:] for activation in model.enc1(torch.rand(1, 3, 48, 48))] == [
        (32, 48, 48),
        (16, 24, 24),
        (16, 24, 24),
        (8, 12, 12),
    ]
    assert model.feature_size == 100
    dense = [layer for layer in model.modules() if isinstance(layer, nn.Linear)]
    assert [(layer.in_features, layer.out_features) for layer in dense] == [
        (8 * 12 * 12, 100),
        (100, 100),
        (200, 100),
        (100, 100),
        (100, 8 * 12 * 12),
    ]
    assert all(isinstance(layer, DropoutLinear) and layer.dropout == 0.5 for layer in dense)


def test_real_network_ties_its_encoders():
    model = RealTranslator((48, 48)).eval()
    images = torch.rand(2, 3, 48, 48) * 2 - 1
    assert torch.equal(model.encode_context(images).features, model.encode(images))
    assert not any(name.startswith("enc2") for name in model.state_dict()), "tied weights are kept once"


def test_dropout_doubles_or_drops_a_dense_layers_inputs_in_training_alone():
    layer = DropoutLinear(1000, 1, 0.5)
    nn.init.ones_(layer.weight)
    nn.init.zeros_(layer.bias)
    kept = layer(torch.ones(50, 1000)) / 2000
    assert kept.min() > 0.4 and kept.max() < 0.6 and kept.std() > 0
    with evaluating(layer):
        assert torch.equal(layer(torch.ones(1, 1000)), torch.full((1, 1), 1000.0))
    assert layer.training, "and training goes on as before"


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
        torch.manual_seed(0)  # the same dropout
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


@pytest.mark.parametrize("size", [(16, 16), (20, 24)])
@pytest.mark.parametrize("arch", ["compact", "real"])
def test_a_network_is_only_made_as_large_as_its_file(arch, size, tmp_path):
    model = make_translator(arch, size)
    assert model.dec_head.weight.shape == NETWORKS[arch].head_shape(size)

    def written(**config):
        arrays = {f"weights/{name}": values.numpy() for name, values in model.state_dict().items()}
        arrays = {name: np.asarray(values[:0] if "dec_head" not in name else values) for name, values in arrays.items()}
        path = tmp_path / "a.translator.h5"
        return read_artifact(write_artifact(path, "translator", arrays, config=config, seed=0, command="ifo"))

    with pytest.raises(
        ArtifactError, match=r"a\.translator\.h5: .*do not fit architecture .* of 1000000x1000000 pixels"
    ):
        load_translator(written(arch=arch, size=[1_000_000, 1_000_000]))
    with pytest.raises(ArtifactError, match=rf"do not fit architecture {arch} \("):
        load_translator(written(arch=arch, size=list(size)))
