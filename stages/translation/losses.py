"""The translator's objective L = L_trans + lambda_1 L_rec + lambda_2 L_align (Sec. IV)."""

from __future__ import annotations

from dataclasses import dataclass

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
    count, frames = videos.shape[:2]
    flat = videos.flatten(0, 1)
    features = model.encode(flat)
    context = model.encode_context(contexts)
    z1 = features.unflatten(0, (count, frames))
    decoded = model.decode(features, context)
    weights = None
    if motion_weight:
        moved = (videos - contexts[:, None]).abs().amax(dim=2, keepdim=True) > 0.1
        weights = 1.0 + motion_weight * moved.flatten(0, 1)

    def squared(difference: Tensor) -> Tensor:
        squares = difference.square()
        return (squares if weights is None else squares * weights).sum() / len(flat)

    rec = squared(decoded - flat)
    trans = align = flat.new_zeros(())
    for source in sources:
        z3 = model.translate(z1[source].flatten(0, 1), context)
        align = align + (z3 - features).square().sum() / len(flat)
        trans = trans + squared(model.decode(z3, context) - flat)
    pairings = max(len(sources), 1)
    return {"trans": trans / pairings, "rec": rec, "align": align / pairings}
