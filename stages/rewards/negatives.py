"""Fine-tuning of Enc1 on the learner's own frames.

Enc1 is not trained on frames of unskilled policies and may rate them too high. The paper names this weakness (Sec. V.A)
and addresses it with R_img. Here, frames of the learner serve as negatives, as in Rank2Reward and BootIfOL. The
features learn to rank each of them below translated demonstrations at the same time, with a margin equal to the
difference of their pixel distances from the target. A frame that looks like the target is not a negative, so the
ranking remains valid while the policy improves.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from stages.rewards.tracking import TrackingTarget
from stages.runtime.seeding import generator
from stages.runtime.trees import check_optimiser, from_tree, to_tree
from stages.translation.networks import Translator, to_images

BATCH = 64  # positives per step; the number of negatives is the same
STEPS = 20  # optimizer steps per tuning
LEARNING_RATE = 1e-4
KEEP = 1.0  # weight of the penalty on changes of the features of demonstrations
SEEN = 8  # maximum number of learner frames stored per time and batch of episodes
CAPACITY = 64  # maximum number of learner frames stored per time; new frames replace the oldest


@dataclass(frozen=True)
class Judged:
    """Squared distances (B,) from the target at the same time, divided by the demonstrations' mean motion per frame."""

    features: Tensor
    pixels: Tensor


class NegativeTuning:
    """Stores frames of the learner and tunes a copy of the translator's Enc1 on them.

    Attributes:
        model: Network whose `encode` is tuned.
        every: Number of learner iterations between tunings.
    """

    def __init__(
        self, model: Translator, target: TrackingTarget, positives: np.ndarray, every: int, seed: int, device: str
    ):
        """Tune for `target`; `positives` are translated demonstrations (N, T, H, W, 3), uint8."""
        self.model = copy.deepcopy(model).requires_grad_(True)
        self.every = every
        self._original, self._target, self._positives = model, target, positives
        self._seed, self._device = seed, device
        self._optimiser = torch.optim.Adam(self.model.parameters(), lr=LEARNING_RATE)
        frames = positives.shape[1]
        self._seen = np.zeros((frames, CAPACITY, *positives.shape[2:]), np.uint8)
        self._counts = np.zeros(frames, np.int64)
        self._iteration = 0

    def see(self, frame: int, images: np.ndarray) -> None:
        """Store some of the learner's images (n, H, W, 3), uint8, at frame index `frame`."""
        for image in images[np.linspace(0, len(images) - 1, min(SEEN, len(images))).astype(int)]:
            self._seen[frame, self._counts[frame] % CAPACITY] = image
            self._counts[frame] += 1

    def iterate(self) -> float:
        """End an iteration of the learner, and tune the features if tuning is due.

        Returns:
            The share of pairs of demonstration frame and negative that the features rank correctly, before tuning.
        """
        rng = generator(self._seed, "negatives", self._iteration)
        self._iteration += 1
        with torch.no_grad():
            ranked = float((self._gap(*self._batch(rng)) > 0).float().mean())
        if self._iteration % self.every == 0:
            for _ in range(STEPS):
                self._optimiser.zero_grad(set_to_none=True)
                self._loss(rng).backward()
                self._optimiser.step()
        return ranked

    def _batch(self, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Draw times (B,), and positives and negatives (B, 3, H, W) at these times."""
        times = rng.choice(np.flatnonzero(self._counts), BATCH)
        positives = self._positives[rng.integers(len(self._positives), size=BATCH), times]
        negatives = self._seen[times, rng.integers(np.minimum(self._counts[times], CAPACITY))]
        good, bad = (to_images(torch.from_numpy(x.copy())).to(self._device) for x in (positives, negatives))
        return torch.from_numpy(times), good, bad

    def _judge(self, times: Tensor, images: Tensor) -> Judged:
        frames = len(self._seen)
        features = self._target.feature_error(self.model.encode(images), times)
        pixels = self._target.image_error(images, times) / (2 if self._target.blurs else 1)
        return Judged(frames * features, frames * pixels)

    def _gap(self, times: Tensor, positives: Tensor, negatives: Tensor) -> Tensor:
        """Feature distances of negatives minus those of positives, for pairs with the farther pixels in the negative.

        Positive gaps are correct rankings.
        """
        good, bad = self._judge(times, positives), self._judge(times, negatives)
        further = bad.pixels > good.pixels
        return (bad.features - good.features)[further]

    def _loss(self, rng: np.random.Generator) -> Tensor:
        times, positives, negatives = self._batch(rng)
        good, bad = self._judge(times, positives), self._judge(times, negatives)
        margin = (bad.pixels - good.pixels).clamp_min(0.0)
        # A negative whose pixels are as close to the target as those of the demonstration has margin zero.
        ranking = F.relu(margin - (bad.features - good.features)).mean()
        with torch.no_grad():
            before = self._original.encode(positives)
        moved = (self.model.encode(positives) - before).square().sum(dim=1).mean()
        return ranking + KEEP * moved * (len(self._seen) / self._target.feature_scale)

    def state(self) -> dict[str, Any]:
        """The complete state that determines the rest of tuning, as a tree of arrays and numbers."""
        return {
            "model": to_tree(self.model.state_dict()),
            "optimiser": to_tree(self._optimiser.state_dict()),
            "seen": self._seen,
            "counts": self._counts,
            "iteration": self._iteration,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state returned by `state`, bit for bit."""
        self.model.load_state_dict(from_tree(state["model"]))
        self._optimiser.load_state_dict(from_tree(state["optimiser"]))
        check_optimiser(self._optimiser)
        self._seen, self._counts = np.array(state["seen"]), np.array(state["counts"])
        self._iteration = int(state["iteration"])
