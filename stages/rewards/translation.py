"""The translation reward (Sec. V.A) for environments that run in lockstep: frames are encoded and compared."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stages.environments.timing import Timing
from stages.rewards.frames import FrameReward, time_weights
from stages.rewards.tracking import TrackingReward, TrackingTarget
from stages.translation.networks import Translator

if TYPE_CHECKING:
    from stages.rewards.negatives import NegativeTuning


class BatchTranslationReward(FrameReward):
    """The translation reward of n environments in one fixed context; encodes their frames."""

    def __init__(
        self,
        timing: Timing,
        model: Translator,
        target: TrackingTarget,
        without: tuple[str, ...] = (),
        image_weight: float = 1.0,
        ramp: str = "none",
        device: str = "cpu",
        tuning: NegativeTuning | None = None,
    ):
        """Track `target`.

        Args:
            timing: When episodes show frames.
            model: The translator.
            target: Target to track.
            without: Terms to switch off: `feat` or `img`.
            image_weight: Weight w_rec of R_img.
            ramp: Weighting of frames over time; see `time_weights`.
            device: Torch device of the model and the target.
            tuning: Fine-tuning on the learner's frames; its network then computes the features.
        """
        super().__init__(timing)
        self._tuning = tuning
        features_of = model if tuning is None else tuning.model
        weights = time_weights(ramp, timing.frames)
        self._reward = TrackingReward(features_of, target, weights, image_weight, without, device)
        self._ranked = float("nan")

    def judge(self, frame: int, drawn: np.ndarray) -> np.ndarray:
        if self._tuning is not None:
            self._tuning.see(frame, drawn)
        total = np.zeros(len(drawn))
        for term, values in self._reward(drawn, frame).items():
            self.add(term, values)
            total += values
        return total

    def terms(self) -> dict[str, float]:
        means = super().terms()
        return means if self._tuning is None else {**means, "ranked": self._ranked}

    def iterate(self) -> None:
        if self._tuning is not None:
            self._ranked = self._tuning.iterate()

    def state(self) -> dict[str, Any]:
        return {} if self._tuning is None else self._tuning.state()

    def restore(self, state: dict[str, Any]) -> None:
        if self._tuning is not None:
            self._tuning.restore(state)
