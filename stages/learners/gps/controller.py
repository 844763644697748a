"""Time-varying linear-Gaussian controllers, u_t ~ N(K_t x_t + k_t, C_t)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class LinearGaussianController:
    """A time-varying linear-Gaussian controller for T control steps.

    Attributes:
        gains: Feedback gains K_t (T, du, dx).
        offsets: Offsets k_t (T, du).
        covariances: Covariances C_t (T, du, du) of the actions.
    """

    gains: np.ndarray
    offsets: np.ndarray
    covariances: np.ndarray

    @classmethod
    def constant(cls, steps: int, state_size: int, action_size: int, std: float) -> LinearGaussianController:
        """A controller that ignores the state: actions have mean zero and standard deviation `std`."""
        covariance = std**2 * np.eye(action_size)
        return cls(
            np.zeros((steps, action_size, state_size)),
            np.zeros((steps, action_size)),
            np.tile(covariance, (steps, 1, 1)),
        )

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> LinearGaussianController:
        """The controller whose method `arrays` returned the given arrays.

        Raises:
            KeyError: An array is missing.
            ValueError: The shapes do not match, a value is not finite, or a covariance is not symmetric and positive
                definite.
        """
        made = cls(*(np.asarray(arrays[name], np.float64) for name in ("gains", "offsets", "covariances")))
        steps, action_size = made.offsets.shape
        if made.gains.shape[:2] != (steps, action_size) or made.covariances.shape != (steps, action_size, action_size):
            raise ValueError(f"gains {made.gains.shape} and offsets {made.offsets.shape} do not match")
        if not steps:
            raise ValueError("it has no control steps")
        if not all(np.isfinite(array).all() for array in made.arrays().values()):
            raise ValueError("some values are not finite")
        if not np.allclose(made.covariances, made.covariances.swapaxes(1, 2)):
            raise ValueError("a covariance is not symmetric")
        np.linalg.cholesky(made.covariances)
        return made

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays stored in artifacts and checkpoints."""
        return {"gains": self.gains, "offsets": self.offsets, "covariances": self.covariances}

    @property
    def steps(self) -> int:
        """Number of control steps, T."""
        return len(self.offsets)

    def act(self, step: int, states: np.ndarray) -> np.ndarray:
        """Mean actions (n, du) in states (n, dx) at control step `step`."""
        return states @ self.gains[step].T + self.offsets[step]

    def sample(self, step: int, states: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Actions (n, du) in states (n, dx) at control step `step`, sampled with standard normal noise (n, du)."""
        return self.act(step, states) + noise @ np.linalg.cholesky(self.covariances[step]).T

    def widened(self, least: float) -> LinearGaussianController:
        """The controller with a standard deviation of at least `least` in every direction of the action space."""
        variances, directions = np.linalg.eigh(self.covariances)
        scaled = directions * np.maximum(variances, least**2)[:, None]
        return replace(self, covariances=scaled @ directions.swapaxes(1, 2))

    def lifted(self, state_size: int) -> LinearGaussianController:
        """The controller for states of `state_size` entries; it ignores the entries that are appended."""
        more = state_size - self.gains.shape[2]
        return replace(self, gains=np.pad(self.gains, ((0, 0), (0, 0), (0, more))))

    def std(self) -> float:
        """Mean standard deviation of the actions."""
        return float(np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2)).mean())
