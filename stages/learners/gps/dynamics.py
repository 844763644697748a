"""Time-varying linear-Gaussian dynamics, fitted to rollouts by regression with a Gaussian mixture as prior.

x_{t+1} ~ N(F_t [x_t; u_t] + f_t, S_t). Ten rollouts are too few to fit a dozen or more dimensions at each time step,
but the dynamics at different time steps are similar. Therefore a mixture over (x, u, x') from all time steps and the
last iterations provides a normal-inverse-Wishart prior for each time step (Levine et al. 2016, Sec. 5.3 and appendix
A.3).

This is not sufficient if the state contains image features. The fitted dynamics then predict the next iteration's
frames worse than a copy of the current ones does, because slopes are steep in directions with little variation. In this
case the scatter at neighboring time steps is used as well, and slopes are shrunk towards "no change". If the state has
only a few entries, for example the position of a can, this smoothing blurs the time of contact and makes results worse
(results/LOG.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.learners.gps.gmm import Mixture, fit_mixture

MOST_CLUSTERS = 20
POINTS_A_CLUSTER = 40  # minimum mean number of points per cluster
STRENGTH = 1.0  # weight of the prior, as a number of rollouts
NEIGHBOURS, NEARNESS = 2, 0.7  # number of neighboring time steps used on each side, and decay of weight per neighbor
RIDGE = 0.1  # share of each regressor's variance that is added to it
RECALL = 0.6  # decay of the weight of rollouts per iteration of age
JITTER = 1e-6  # share of the pooled variance that is added to every variance


@dataclass(frozen=True)
class Dynamics:
    """Linear-Gaussian dynamics for T time steps.

    Attributes:
        transition: Transition matrices F_t (T, dx, dx + du).
        offset: Offsets f_t (T, dx).
        noise: Noise covariances S_t (T, dx, dx).
    """

    transition: np.ndarray
    offset: np.ndarray
    noise: np.ndarray


def transitions(states: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """Points (x, u, x') (N, T, 2 dx + du) of rollouts with states (N, T + 1, dx) and actions (N, T, du)."""
    return np.concatenate([states[:, :-1], actions, states[:, 1:]], axis=2)


def fit_prior(points: np.ndarray, rng: np.random.Generator, start: Mixture | None = None) -> Mixture:
    """Fit the mixture over all transitions (N, T, 2 dx + du), starting from that of the previous iteration."""
    flat = points.reshape(-1, points.shape[2])
    clusters = int(np.clip(len(flat) // POINTS_A_CLUSTER, 1, MOST_CLUSTERS))
    return fit_mixture(flat, clusters, rng, start)[0]


def fit_dynamics(
    states: np.ndarray,
    actions: np.ndarray,
    prior: Mixture | None = None,
    period: int | None = None,
    earlier: Sequence[np.ndarray] = (),
) -> Dynamics:
    """Fit the dynamics at each time step to N rollouts.

    Args:
        states: States (N, T + 1, dx).
        actions: Actions (N, T, du).
        prior: Mixture over (x, u, x'); None: regression without a prior.
        period: Control steps per frame if the state contains image features: time steps that are up to two frames
            earlier or later, at the same phase between two frames, are used as well, and slopes of x_{t+1} - x_t are
            shrunk. None: the state has no image features.
        earlier: Transitions (M, T, 2 dx + du) of the rollouts of earlier iterations, newest first.
    """
    points = transitions(states, actions)
    count, steps, both = points.shape
    size = states.shape[2]
    given = both - size  # number of dimensions of (x, u)
    jitter = np.diag(JITTER * (points.reshape(-1, both).var(axis=0) + 1e-6))
    means = points.mean(axis=0)
    scatters, counts = np.zeros((steps, both, both)), np.zeros(steps)
    spread = points.var(axis=0) + np.diag(jitter)
    for age, recalled in enumerate((points, *earlier)):
        apart = (recalled - means).swapaxes(0, 1)
        far = (np.square(apart).mean(axis=1) / spread).mean(axis=1)  # in units of their variance
        weight = RECALL**age * np.minimum(1 / far, 1)
        scatters += weight[:, None, None] * (apart.swapaxes(1, 2) @ apart)
        counts += weight * len(recalled)
    if period is not None:
        shares = neighbours(steps, period)
        scatters, counts = np.einsum("ts,sij->tij", shares, scatters), shares @ counts
    shrunk = 0.0 if period is None else RIDGE
    change = np.eye(both)
    change[given:, :size] -= np.eye(size)  # (x, u, x') -> (x, u, x' - x)
    transition = np.empty((steps, size, given))
    offset, noise = np.empty((steps, size)), np.empty((steps, size, size))
    for t in range(steps):
        scatter, total = scatters[t], counts[t]
        if prior is not None:
            prior_mean, prior_covariance = prior.moments(points[:, t])
            scatter, total = scatter + STRENGTH * prior_covariance, total + STRENGTH
            if period is None:
                between = means[t] - prior_mean
                scatter = scatter + count * STRENGTH / (count + STRENGTH) * np.outer(between, between)
        covariance = scatter / total + jitter
        changes = change @ covariance @ change.T
        known = changes[:given, :given]
        slope = np.linalg.solve(known + shrunk * np.diag(np.diag(known)), changes[:given, given:]).T
        slope[:, :size] += np.eye(size)
        transition[t], offset[t] = slope, means[t, given:] - slope @ means[t, :given]
        residual = np.concatenate([-slope, np.eye(size)], axis=1)
        noise[t] = residual @ covariance @ residual.T
    return Dynamics(transition, offset, noise)


def neighbours(steps: int, period: int) -> np.ndarray:
    """Weights (T, T) with which each time step (row) uses the scatter of rollouts at each time step (column)."""
    apart = np.abs(np.subtract.outer(np.arange(steps), np.arange(steps)))
    near = (apart % period == 0) & (apart <= period * NEIGHBOURS)
    return np.where(near, NEARNESS ** (apart / period), 0.0)
