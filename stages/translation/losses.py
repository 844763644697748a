"""The training objective of the translator, L = L_trans + lambda_1 L_rec + lambda_2 L_align (Sec. IV)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from stages.translation.networks import Translator


@dataclass(frozen=True)
class LossWeights:
    """Weights of the losses; zero disables a loss.

    Attributes:
        trans: Weight of L_trans (1 in the paper).
        rec: Weight of L_rec, lambda_1.
        align: Weight of L_align, lambda_2.
    """

    trans: float
    rec: float
    align: float


def translation_losses(
    model: Translator,
    videos: Tensor,
    contexts: Tensor,
    sources: list[Tensor],
    motion_weight: float = 0.0,
    reconstructed: Tensor | None = None,
    translated: Tensor | None = None,
) -> dict[str, Tensor]:
    """L_trans, L_rec and L_align of pairs of videos; each is a sum over pixels or features, averaged over frames.

    Every video is the source of one pair and the target of another. Each frame is therefore encoded once, and its
    features serve as z_1 of the first pair and as the alignment target Enc1(o_t^j) of the second.

    Args:
        model: The translator.
        videos: Frames (V, K, 3, H, W) of V videos at K shared time indices, in [-1, 1].
        contexts: First frames o_0 (V, 3, H, W) of the videos.
        sources: Permutations (V,): in pairing m, video sources[m][j] is translated into the context of video j.
        motion_weight: Additional weight of pixels that differ from the context frame (0: losses of the paper).
        reconstructed: Indices (R,) of the times at which L_rec is computed (None: all K).
        translated: Indices of the times at which L_trans is computed (None: all K). L_align needs no images, and is
            computed at all times.

    Returns:
        Scalars `trans`, `rec` and `align`.
    """
    count = len(videos)
    encoded, context = model.encode_all(videos.flatten(0, 1), contexts)
    features = encoded.unflatten(0, (count, -1))
    predicted = [
        model.translate(features[source].flatten(0, 1), context).unflatten(0, (count, -1)) for source in sources
    ]
    everything = slice(None)
    shown = everything if reconstructed is None else reconstructed
    chosen = everything if translated is None else translated
    own, truth = features[:, shown], videos[:, chosen]
    # Decode reconstructions and translations in one call of Dec, so that the context's skips are convolved only once.
    wanted = torch.cat([own, *(z3[:, chosen] for z3 in predicted)], dim=1)
    decoded = model.decode(wanted.flatten(0, 1), context).unflatten(0, (count, -1))
    reconstruction, *translations = decoded.split([own.shape[1], *[truth.shape[1]] * len(sources)], dim=1)
    weights = torch.ones_like(videos[:, :, :1])
    if motion_weight:
        weights = 1.0 + motion_weight * ((videos - contexts[:, None]).abs().amax(dim=2, keepdim=True) > 0.1)

    def squared(images: Tensor, truth: Tensor, weight: Tensor) -> Tensor:
        squares = (images - truth).square()
        return (squares * weight if motion_weight else squares).sum() / (count * truth.shape[1])

    n = count * videos.shape[1]
    pairings = max(len(sources), 1)
    zero = videos.new_zeros(())
    return {
        "trans": sum((squared(images, truth, weights[:, chosen]) for images in translations), zero) / pairings,
        "rec": squared(reconstruction, videos[:, shown], weights[:, shown]),
        "align": sum(((z3 - features).square().sum() / n for z3 in predicted), zero) / pairings,
    }
