"""The environment's own reward: the oracle of a Gymnasium environment."""

from __future__ import annotations

from typing import Any

import numpy as np

from stages.environments.foreign import ForeignMoment
from stages.environments.protocol import Moment


class OwnReward:
    """The reward that a Gymnasium environment itself gives; a policy learned from it needs no demonstrations."""

    def __init__(self) -> None:
        self._sum, self._episodes = 0.0, 0

    def __call__(self, moment: Moment, action: np.ndarray) -> np.ndarray:
        assert isinstance(moment, ForeignMoment)
        self._episodes += moment.step == 1
        self._sum += float(moment.own_reward.mean())
        return moment.own_reward

    def terms(self) -> dict[str, float]:
        mean = self._sum / max(self._episodes, 1)
        self._sum, self._episodes = 0.0, 0
        return {"return": mean}

    def iterate(self) -> None:
        """No-op, because the reward never changes."""

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """No-op, because there is no state."""

    def close(self) -> None:
        """No-op, because there are no resources to free."""
