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
@pytest.mark.parametrize(
    ("reconstructed", "translated", "motion_weight"),
    [(None, None, 0.0), ([1], None, 0.0), (None, None, 2.5), ([1, 0], [0], 2.5), ([1], [0], 0.0)],
)
def test_losses_equal_their_definition_frame_by_frame(network, reconstructed, translated, motion_weight):
    with torch.random.fork_rng():
        torch.manual_seed(1)
        model = network().double()
        for parameter in model.parameters():
            parameter.data += 0.05 * torch.randn_like(parameter)
        videos = torch.rand(3, 3, 3, 16, 16, dtype=torch.float64) * 2 - 1
    sources = [torch.tensor([2, 0, 1]), torch.tensor([1, 2, 0])]
    chosen = [None if times is None else torch.tensor(times) for times in (reconstructed, translated)]
    got = translation_losses(model, videos[:, 1:], videos[:, 0], sources, motion_weight, *chosen)
    times, decoded = (range(2) if times is None else times for times in (reconstructed, translated))
    trans = rec = align = 0.0
    for j in range(3):
        context = model.encode_context(videos[j, :1])
        for t in range(1, 3):
            truth = videos[j, t : t + 1]
            moved = ((truth - videos[j, 0]).abs() > 0.1).any(dim=1, keepdim=True)
            weight = 1 + motion_weight * moved
            own = model.encode(truth)
            for source in sources:
                z3 = model.translate(model.encode(videos[source[j], t : t + 1]), context)
                if t - 1 in decoded:
                    trans += (weight * (model.decode(z3, context) - truth).square()).sum() / (6 * len(decoded))
                align += (z3 - own).square().sum() / 12
            if t - 1 in times:
                rec += (weight * (model.decode(own, context) - truth).square()).sum() / (3 * len(times))
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


def test_without_pairings_only_reconstruction_is_left():
    model, videos = compact(), torch.rand(2, 2, 3, 16, 16) * 2 - 1
    with torch.no_grad():
        got = translation_losses(model, videos, videos[:, 0], [])
        paired = translation_losses(model, videos, videos[:, 0], [torch.tensor([1, 0])])
    assert float(got["trans"]) == float(got["align"]) == 0.0
    torch.testing.assert_close(got["rec"], paired["rec"])
    assert got["trans"].shape == ()
