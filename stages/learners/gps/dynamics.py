"""Time-varying linear-Gaussian dynamics, fitted to rollouts by regression with a mixture of Gaussians as prior.

x_{t+1} ~ N(F_t [x_t; u_t] + f_t, S_t). Ten rollouts say too little about some dozen dimensions at one time step; but
what the robot does at one time resembles what it does at others. So a mixture over (x, u, x') of all time steps and of
the last iterations gives each time step a normal-inverse-Wishart prior (Levine et al. 2016, Sec. 5.3 and appendix A.3).

That is not enough where images are in the state: dynamics so fitted foretell the next iteration's frames worse than "as
they were in this one" does, for slopes are steep where hardly anything varied. There the rollouts' spread a few time
steps before and after counts as well, and slopes are shrunk towards "nothing changes". Where the state is some few
numbers, such as where a can is, that blurs when it is touched, and does harm (results/LOG.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.learners.gps.gmm import Mixture, fit_mixture

MOST_CLUSTERS = 20
POINTS_A_CLUSTER = 40  # at least, on average
STRENGTH = 1.0  # rollouts that the prior counts as
NEIGHBOURS, NEARNESS = 2, 0.7  # time steps to either side that count, and how much one counts beside the one before
RIDGE = 0.1  # of a regressor's variance, added to it
RECALL = 0.6  # how much an iteration's rollouts count beside those of the one after it
JITTER = 1e-6  # of the pooled variance, added to every variance


@dataclass(frozen=True)
class Dynamics:
    """Linear-Gaussian dynamics of T time steps.

    Attributes:
        transition: F_t (T, dx, dx + du).
        offset: f_t (T, dx).
        noise: S_t (T, dx, dx).
    """

    transition: np.ndarray
    offset: np.ndarray
    noise: np.ndarray


def transitions(states: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """Points (x, u, x') (N, T, 2 dx + du) of rollouts: states (N, T + 1, dx), actions (N, T, du)."""
    return np.concatenate([states[:, :-1], actions, states[:, 1:]], axis=2)


def fit_prior(points: np.ndarray, rng: np.random.Generator, start: Mixture | None = None) -> Mixture:
    """The mixture over all transitions (N, T, 2 dx + du), going on from that of the iteration before."""
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
    """Fit the dynamics of each time step to N rollouts.

    Args:
        states: (N, T + 1, dx).
        actions: (N, T, du).
        prior: Mixture over (x, u, x'); None: regression without a prior.
        period: Control steps from one frame to the next, of states with images: neighbours in time, at the same place
            between two frames, count as well, and slopes of x_{t+1} - x_t are shrunk.
        earlier: Transitions (M, T, 2 dx + du) of earlier iterations' rollouts, the newest iteration first.
    """
    points = transitions(states, actions)
    count, steps, both = points.shape
    size = states.shape[2]
    given = both - size  # dimensions of (x, u)
    jitter = np.diag(JITTER * (points.reshape(-1, both).var(axis=0) + 1e-6))
    means = points.mean(axis=0)
    scatters, counts = np.zeros((steps, both, both)), np.zeros(steps)
    spread = points.var(axis=0) + np.diag(jitter)
    for age, recalled in enumerate((points, *earlier)):
        apart = (recalled - means).swapaxes(0, 1)
        far = (np.square(apart).mean(axis=1) / spread).mean(axis=1)  # how far, over the present rollouts' spread
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
    """How much each time step (row) takes the rollouts' spread at every other (column) for its own (T, T)."""
    apart = np.abs(np.subtract.outer(np.arange(steps), np.arange(steps)))
    near = (apart % period == 0) & (apart <= period * NEIGHBOURS)
    return np.where(near, NEARNESS ** (apart / period), 0.0)
