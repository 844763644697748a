"""The translator's objective L = L_trans + lambda_1 L_rec + lambda_2 L_align (Sec. IV)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from stages.translation.networks import Translator


@dataclass(frozen=True)
class LossWeights:
    """Weights of the losses; zero switches one off.

    Attributes:
        trans: Weight of L_trans (the paper: 1).
        rec: lambda_1.
        align: lambda_2.
    """

    trans: float
    rec: float
    align: float


def translation_losses(
    model: Translator, videos: Tensor, contexts: Tensor, sources: list[Tensor], motion_weight: float = 0.0
) -> dict[str, Tensor]:
    """L_trans, L_rec and L_align of pairs of videos, each a sum over pixels or features, averaged over frames.

    Every video is source of one pair and target of another, so each frame is encoded once, as z_1 of the one and as
    the alignment target Enc1(o_t^j) of the other.

    Args:
        videos: Frames (V, K, 3, H, W) of V videos at K shared time indices, in [-1, 1].
        contexts: First frames o_0 (V, 3, H, W) of the videos.
        sources: Permutations (V,): in pairing m, video sources[m][j] is translated into the context of video j.
        motion_weight: Extra weight of pixels that differ from the context frame (0: the paper's losses).

    Returns:
        Scalars `trans`, `rec` and `align`.
    """
    count = len(videos)
    features = model.encode(videos.flatten(0, 1)).unflatten(0, (count, -1))
    context = model.encode_context(contexts)
    translated = [
        model.translate(features[source].flatten(0, 1), context).unflatten(0, (count, -1)) for source in sources
    ]
    # One call of Dec for reconstructions and translations: the context's skips are convolved once for all of them.
    decoded = model.decode(torch.cat([features, *translated], dim=1).flatten(0, 1), context)
    reconstruction, *translations = decoded.unflatten(0, (count, -1)).split(videos.shape[1], dim=1)
    weights = None
    if motion_weight:
        weights = 1.0 + motion_weight * ((videos - contexts[:, None]).abs().amax(dim=2, keepdim=True) > 0.1)

    n = count * videos.shape[1]

    def squared(images: Tensor) -> Tensor:
        squares = (images - videos).square()
        return (squares if weights is None else squares * weights).sum() / n

    pairings = max(len(sources), 1)
    zero = videos.new_zeros(())
    return {
        "trans": sum(map(squared, translations), zero) / pairings,
        "rec": squared(reconstruction),
        "align": sum(((z3 - features).square().sum() / n for z3 in translated), zero) / pairings,
    }
