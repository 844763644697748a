"""What a reward is to a learner."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from stages.simulation.contexts import Contexts
from stages.simulation.task import State


class Reward(Protocol):
    """A reward for n simulations that step together."""

    def __call__(self, step: int, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        """Reward (n,) of the action (n, nu) that led to `state`, the state after `step` control steps (1, 2, ...)."""
        ...

    def terms(self) -> dict[str, float]:
        """Mean return an episode of each of the reward's terms since the last call; forgets them."""
        ...

    def iterate(self) -> None:
        """End an iteration of the learner: a reward that learns from rollouts changes here, and only here."""
        ...

    def state(self) -> dict[str, Any]:
        """What has changed since the reward was made, as a tree of arrays and numbers (for checkpoints)."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Put `state` back."""
        ...

    def close(self) -> None:
        """Free what the reward holds (render processes, networks)."""
        ...
