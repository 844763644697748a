"""The reward interface that learners use."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np

from stages.environments.protocol import Moment


class Reward(Protocol):
    """A reward for n environments that run in lockstep."""

    def __call__(self, moment: Moment, action: np.ndarray) -> np.ndarray:
        """Reward (n,) of the actions (n, nu) that led to `moment`, after 1, 2, ... control steps."""
        ...

    def terms(self) -> dict[str, float]:
        """Mean return per episode of each term of the reward since the last call; resets the means."""
        ...

    def iterate(self) -> None:
        """End an iteration of the learner. A reward that learns from rollouts changes here, and only here."""
        ...

    def state(self) -> dict[str, Any]:
        """All state that has changed since construction, as a tree of arrays and numbers (for checkpoints)."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state returned by `state`."""
        ...

    def close(self) -> None:
        """Free the resources of the reward (render processes, networks)."""
        ...


@runtime_checkable
class TrackingReward(Reward, Protocol):
    """A reward that is a negative squared distance to a target, as trajectory-centric learners require.

    The cost after t control steps is 1/2 w_t |z_t - z*_t|^2, where z_t are the tracked values.

    Attributes:
        targets: Targets z*_t (control steps + 1, m).
        cost_weights: Weights w_t (control steps + 1,).
        finer: Reward to continue with once the target is nearly reached; None: keep this one.
        frame_period: Control steps between two frames that the reward observes; None: it observes every state.
    """

    targets: np.ndarray
    cost_weights: np.ndarray
    finer: TrackingReward | None
    frame_period: int | None

    def tracked(self, moment: Moment) -> np.ndarray:
        """Tracked values z_t (n, m) of `moment`.

        For steps after 0, the reward must have been called with the same moment before.
        """
        ...
