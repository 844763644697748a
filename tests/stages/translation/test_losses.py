"""The objective equals its definition in Sec. IV, written out pair by pair and frame by frame."""

import pytest
import torch

from stages.translation.losses import translation_losses
from stages.translation.networks import CompactTranslator, RealTranslator, Translator


def compact() -> Translator:
    return CompactTranslator((16, 16), 12, 8, 8, 16)


def real() -> Translator:
    return RealTranslator((16, 16)).eval()  # Without dropout, which no two frames have in common.


@pytest.mark.parametrize("network", [compact, real])
@pytest.mark.parametrize("reconstructed", [None, [2, 0]])
def test_losses_equal_their_definition_frame_by_frame(network, reconstructed):
    with torch.random.fork_rng():
        torch.manual_seed(1)
        model = network().double()
        for parameter in model.parameters():
            parameter.data += 0.05 * torch.randn_like(parameter)
        videos = torch.rand(3, 4, 3, 16, 16, dtype=torch.float64) * 2 - 1
    source = torch.tensor([2, 0, 1])
    chosen = None if reconstructed is None else torch.tensor(reconstructed)
    got = translation_losses(model, videos[:, 1:], videos[:, 0], [source], reconstructed=chosen)
    times = range(3) if reconstructed is None else reconstructed
    trans = rec = align = 0.0
    for j in range(3):
        context = model.encode_context(videos[j, :1])
        for t in range(1, 4):
            z1 = model.encode(videos[source[j], t : t + 1])
            z3 = model.translate(z1, context)
            truth = videos[j, t : t + 1]
            own = model.encode(truth)
            trans += (model.decode(z3, context) - truth).square().sum() / 9
            if t - 1 in times:
                rec += (model.decode(own, context) - truth).square().sum() / (3 * len(times))
            align += (z3 - own).square().sum() / 9
    torch.testing.assert_close(got["trans"], trans)
    torch.testing.assert_close(got["rec"], rec)
    torch.testing.assert_close(got["align"], align)


def test_motion_weight_counts_moving_pixels_more():
    model = compact()
    still = torch.zeros(2, 3, 3, 16, 16)
    moved = still.clone()
    moved[:, 1:, :, 4:8, 4:8] = 1.0
    source = [torch.tensor([1, 0])]
    with torch.no_grad():
        plain = translation_losses(model, moved[:, 1:], moved[:, 0], source)
        weighted = translation_losses(model, moved[:, 1:], moved[:, 0], source, motion_weight=3.0)
        unmoved = translation_losses(model, still[:, 1:], still[:, 0], source, motion_weight=3.0)
        unmoved_plain = translation_losses(model, still[:, 1:], still[:, 0], source)
        last = translation_losses(model, moved[:, 1:], moved[:, 0], source, 3.0, reconstructed=torch.tensor([1]))
    assert weighted["rec"] > 2 * plain["rec"]
    torch.testing.assert_close(last["rec"], weighted["rec"], msg="both frames are alike")
    torch.testing.assert_close(unmoved["rec"], unmoved_plain["rec"])
