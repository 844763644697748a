"""The translation's reward for a learner of quadratic costs: what it compares, as some few numbers to track.

Guided policy search has what it tracks in its state (Sec. V.B: 100 features), and fits linear dynamics to it from some
dozen rollouts. So both terms of the reward, R_feat + w_rec R_img, are written as one squared distance: between vectors
of features, pixels and blurred pixels, each divided by the root of its scale. Principal components of the translated
demonstrations reduce these to `MOST` numbers at most, or to as few as hold `KEPT` of their variance. What robot and
target differ in beyond those is one number more, its length, whose target is zero: objects that lie where no
demonstration ever left one are seen by it alone. Far from the target, all sharp pixels lie there, and lead nowhere: so
it weighs less (`BEYOND`) as long as a wide blur leads to the target, and in full, with a narrower blur, once the
learner has come near (`finer`). With `--without img` the vector is the features' components alone, as in the paper.

Between two frames the numbers stay those of the frame last drawn, and cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from artifacts import Artifact
from stages.rewards.frames import FrameReward, time_weights, tracking_cost
from stages.rewards.tracking import TrackingTarget
from stages.simulation.contexts import Contexts
from stages.simulation.render import RenderPool
from stages.simulation.task import State, Task
from stages.translation.networks import to_images

MOST = 32  # components at most
KEPT = 0.999  # of the variance of the translations and their mean: with .99, 5 components, reach ends farther off
BEYOND = 0.25  # weight of what is beyond the components while the learner is far off
TRANSLATIONS = 32  # of them at most, whose frames the components are those of

Embedding = Callable[[Tensor, Tensor], Tensor]


class ProjectedTrackingReward(FrameReward):
    """-w_j |z_j - z*_j|^2 of frame j, z being the principal components of the frame's embedding, and what is beyond.

    Attributes:
        targets: z* of the frame last drawn, at every control step (control steps + 1, m).
        cost_weights: Twice w_j at control steps that a frame shows but the first, else 0 (control steps + 1,).
        finer: What to track once the target is near, or None.
        components: How many of z are components.
    """

    def __init__(
        self,
        task: Task,
        context: Contexts,
        pool: RenderPool,
        embed: Callable[[np.ndarray], np.ndarray],
        target: np.ndarray,
        examples: np.ndarray,
        ramp: str = "none",
        most: int = MOST,
        beyond: float = BEYOND,
        finer: ProjectedTrackingReward | None = None,
    ):
        """Track `target` in `context` (leading axis 1).

        Args:
            task: The task.
            context: The learner's.
            pool: Draws.
            embed: Maps frames (n, H, W, 3), uint8, to embeddings (n, E).
            target: Embeddings to track (T, E).
            examples: Embeddings (M, E), whose principal components z is made of.
            ramp: `quadratic` weights frame j by j^2, scaled to a mean of one.
            most: Components at most.
            beyond: Weight of how far the embedding is from the target's beyond the components; 0: it is not tracked.
            finer: What to track once the target is near.
        """
        super().__init__(task, context, pool)
        self._embed = embed
        self._centre, self._basis = principal_components(np.concatenate([examples, target]), most)
        self._frame_weights = time_weights(ramp, task.frames)
        self._embedded_target, self._beyond, self.finer = target, beyond, finer
        self._frame_targets = np.stack([self._project(each[None], j)[0] for j, each in enumerate(target)])
        self.components = self._basis.shape[1]
        self.targets, self.cost_weights = tracking_cost(task, self._frame_targets, self._frame_weights)
        self._seen = np.empty((0, self._frame_targets.shape[1]))

    def _project(self, embeddings: np.ndarray, frame: int) -> np.ndarray:
        """z (n, m) of embeddings (n, E) of frame `frame`."""
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

    def tracked(self, step: int, state: State, contexts: Contexts) -> np.ndarray:
        if step == 0:
            self._seen = self._project(self._embed(self._pool.render(self._fields, state.qpos[None])[0]), 0)
        return self._seen


def principal_components(examples: np.ndarray, most: int = MOST) -> tuple[np.ndarray, np.ndarray]:
    """Mean (E,) and orthonormal directions (E, m) of examples (M, E), strongest first; `most`, `KEPT` say how many."""
    centre = examples.mean(axis=0)
    apart = examples - centre
    # By way of the M x M matrix of products: there are fewer examples than pixels.
    strengths, mixtures = np.linalg.eigh(apart @ apart.T)
    strengths, mixtures = np.maximum(strengths[::-1], 0), mixtures[:, ::-1]
    held = np.cumsum(strengths) / max(float(strengths.sum()), 1e-300)
    most = min(most, examples.shape[1], len(examples) - 1)
    count = min(int(np.searchsorted(held, KEPT)) + 1, most)
    directions = apart.T @ mixtures[:, :count]
    return centre, directions / np.maximum(np.linalg.norm(directions, axis=0), 1e-12)


def embedding(target: TrackingTarget, without: tuple[str, ...], image_weight: float) -> Embedding:
    """A function of features (n, D) and images (n, 3, H, W) to (n, E), in which distances are those of the reward."""

    def embed(features: Tensor, images: Tensor) -> Tensor:
        parts = [] if "feat" in without else [features / target.feature_scale**0.5]
        if "img" not in without:
            parts += [(image_weight**0.5 * part).flatten(1) for part in target.image_parts(images)]
        return torch.cat(parts, dim=1)

    return embed


def embedded_translations(source: Artifact, embed: Embedding, target: TrackingTarget) -> tuple[np.ndarray, np.ndarray]:
    """Embeddings of the target (T, E), and of frames of the translations that it is the mean of (M, E)."""
    features = torch.from_numpy(source.read("features", slice(TRANSLATIONS))).flatten(0, 1)
    images = to_images(torch.from_numpy(source.read("images", slice(TRANSLATIONS)))).flatten(0, 1)
    device = target.features.device
    with torch.no_grad():
        goal = embed(target.features, target.images)
        examples = embed(features.to(device), images.to(device))
    return goal.double().cpu().numpy(), examples.double().cpu().numpy()
