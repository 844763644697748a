"""What a reward is to a learner."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

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


@runtime_checkable
class TrackingReward(Reward, Protocol):
    """A reward that is a squared distance in what it sees, as a trajectory-centric learner needs it.

    Its cost after t control steps is 1/2 w_t |z_t - z*_t|^2.

    Attributes:
        targets: z*_t (control steps + 1, m).
        cost_weights: w_t (control steps + 1,).
        finer: What to track in its place once that is nearly reached; None: nothing else.
        frame_period: Control steps between two frames that the reward sees; None: it sees every state.
    """

    targets: np.ndarray
    cost_weights: np.ndarray
    finer: TrackingReward | None
    frame_period: int | None

    def tracked(self, step: int, state: State, contexts: Contexts) -> np.ndarray:
        """z_t (n, m) of `state`, the state after `step` control steps; behind step 0 the reward was called before."""
        ...
