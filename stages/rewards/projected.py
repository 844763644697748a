"""The translation reward in a low-dimensional form for learners with quadratic costs.

Guided policy search includes the tracked values in its state (100 features in Sec. V.B), and fits linear dynamics to
them from about a dozen rollouts. Therefore both terms of the reward, R_feat + w_rec R_img, are written as one squared
distance between vectors of features, pixels and blurred pixels, each divided by the square root of its scale. Principal
components of the translated demonstrations reduce these vectors to at most `MOST` values, or to as few as contain
`KEPT` of the variance. One more value is the length of the residual beyond the components, whose target is zero. Only
the residual shows objects in places where no demonstration put them. Far from the target, all sharp pixels are in the
residual and do not lead to the target. The residual therefore has a low weight (`BEYOND`) while a wide blur guides the
learner, and full weight with a narrower blur once the learner is near the target (`finer`). With `--without img`, the
vector contains only the components of the features, as in the paper.

Between two frames, the tracked values are those of the previous frame, and the cost is zero.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from artifacts import Artifact
from stages.environments.protocol import Moment
from stages.environments.timing import Timing
from stages.rewards.frames import FrameReward, time_weights, tracking_cost
from stages.rewards.tracking import TrackingTarget
from stages.translation.networks import to_images

MOST = 32  # maximum number of components
KEPT = 0.999  # share of the variance to keep; with 0.99 (5 components), the final distance of reach is larger
BEYOND = 0.25  # weight of the residual beyond the components while the learner is far from the target
TRANSLATIONS = 32  # maximum number of translations for computing the components

Embedding = Callable[[Tensor, Tensor], Tensor]


class ProjectedTrackingReward(FrameReward):
    """Reward -w_j |z_j - z*_j|^2 at frame j, where z are the principal components of its embedding and the residual.

    Attributes:
        targets: Targets z* of the last frame at each control step (control steps + 1, m).
        cost_weights: Cost weights (control steps + 1,): 2 w_j at control steps with a frame, except the first, else 0.
        finer: Reward to continue with once the target is near, or None.
        components: Number of principal components in z.
    """

    def __init__(
        self,
        timing: Timing,
        embed: Callable[[np.ndarray], np.ndarray],
        target: np.ndarray,
        examples: np.ndarray,
        ramp: str = "none",
        most: int = MOST,
        beyond: float = BEYOND,
        finer: ProjectedTrackingReward | None = None,
    ):
        """Track `target`.

        Args:
            timing: When episodes show frames.
            embed: Function from frames (n, H, W, 3), uint8, to embeddings (n, E).
            target: Embeddings to track (T, E).
            examples: Embeddings (M, E) for computing the principal components, together with the target.
            ramp: Weighting of frames over time; see `time_weights`.
            most: Maximum number of components.
            beyond: Weight of the residual between embedding and target beyond the components; 0: it is not tracked.
            finer: Reward to continue with once the target is near.
        """
        super().__init__(timing)
        self._embed = embed
        self._centre, self._basis = principal_components(np.concatenate([examples, target]), most)
        self._frame_weights = time_weights(ramp, timing.frames)
        self._embedded_target, self._beyond, self.finer = target, beyond, finer
        self._frame_targets = np.stack([self._project(each[None], j)[0] for j, each in enumerate(target)])
        self.components = self._basis.shape[1]
        self.targets, self.cost_weights = tracking_cost(timing, self._frame_targets, self._frame_weights)
        self._seen = np.empty((0, self._frame_targets.shape[1]))

    def _project(self, embeddings: np.ndarray, frame: int) -> np.ndarray:
        """Tracked values z (n, m) of embeddings (n, E) at frame index `frame`."""
        seen = (embeddings - self._centre) @ self._basis
        if not self._beyond:
            return seen
        apart = embeddings - self._embedded_target[frame]
        inside = np.square(apart @ self._basis).sum(axis=1)
        beyond = self._beyond**0.5 * np.sqrt(np.maximum(np.square(apart).sum(axis=1) - inside, 0))
        return np.concatenate([seen, beyond[:, None]], axis=1)

    def judge(self, frame: int, drawn: np.ndarray) -> np.ndarray:
        self._seen = self._project(self._embed(drawn), frame)
        apart = np.square(self._seen - self._frame_targets[frame]).sum(axis=1)
        return -self._frame_weights[frame] * apart

    def tracked(self, moment: Moment) -> np.ndarray:
        if moment.step == 0:
            self._seen = self._project(self._embed(moment.frames()), 0)
        return self._seen


def principal_components(examples: np.ndarray, most: int = MOST) -> tuple[np.ndarray, np.ndarray]:
    """Mean (E,) and principal directions (E, m) of examples (M, E), strongest first; `most` and `KEPT` limit m."""
    centre = examples.mean(axis=0)
    apart = examples - centre
    # Use the M x M Gram matrix, because there are fewer examples than pixels.
    strengths, mixtures = np.linalg.eigh(apart @ apart.T)
    strengths, mixtures = np.maximum(strengths[::-1], 0), mixtures[:, ::-1]
    held = np.cumsum(strengths) / max(float(strengths.sum()), 1e-300)
    most = min(most, examples.shape[1], len(examples) - 1)
    count = min(int(np.searchsorted(held, KEPT)) + 1, most)
    directions = apart.T @ mixtures[:, :count]
    return centre, directions / np.maximum(np.linalg.norm(directions, axis=0), 1e-12)


def embedding(target: TrackingTarget, without: tuple[str, ...], image_weight: float) -> Embedding:
    """Function from features (n, D) and images (n, 3, H, W) to vectors (n, E) whose distances give the reward."""

    def embed(features: Tensor, images: Tensor) -> Tensor:
        parts = [] if "feat" in without else [features / target.feature_scale**0.5]
        if "img" not in without:
            parts += [(image_weight**0.5 * part).flatten(1) for part in target.image_parts(images)]
        return torch.cat(parts, dim=1)

    return embed


def embedded_translations(source: Artifact, embed: Embedding, target: TrackingTarget) -> tuple[np.ndarray, np.ndarray]:
    """Embeddings of the target (T, E) and of frames of the translations whose mean is the target (M, E)."""
    features = torch.from_numpy(source.read("features", slice(TRANSLATIONS))).flatten(0, 1)
    images = to_images(torch.from_numpy(source.read("images", slice(TRANSLATIONS)))).flatten(0, 1)
    device = target.features.device
    with torch.no_grad():
        goal = embed(target.features, target.images)
        examples = embed(features.to(device), images.to(device))
    return goal.double().cpu().numpy(), examples.double().cpu().numpy()
