"""Time-varying linear-Gaussian dynamics, fitted to rollouts by regression with a mixture of Gaussians as prior.

x_{t+1} ~ N(F_t [x_t; u_t] + f_t, S_t). Ten rollouts say too little about some dozen dimensions at one time step; but
what the robot does at one time resembles what it does at others. So a mixture over (x, u, x') of all time steps and of
the last iterations gives each time step a normal-inverse-Wishart prior (Levine et al. 2016, Sec. 5.3 and appendix A.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stages.learners.gps.gmm import Mixture, fit_mixture

MOST_CLUSTERS = 20
POINTS_A_CLUSTER = 40  # at least, on average
STRENGTH = 1.0  # rollouts that the prior counts as
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


def fit_dynamics(states: np.ndarray, actions: np.ndarray, prior: Mixture | None = None) -> Dynamics:
    """Fit the dynamics of each time step to N rollouts.

    Args:
        states: (N, T + 1, dx).
        actions: (N, T, du).
        prior: Mixture over (x, u, x'); None: regression without a prior.
    """
    points = transitions(states, actions)
    count, steps, _ = points.shape
    size = states.shape[2]
    given = points.shape[2] - size  # dimensions of (x, u)
    jitter = np.diag(JITTER * (points.reshape(-1, points.shape[2]).var(axis=0) + 1e-6))
    transition = np.empty((steps, size, given))
    offset, noise = np.empty((steps, size)), np.empty((steps, size, size))
    for t in range(steps):
        mean = points[:, t].mean(axis=0)
        apart = points[:, t] - mean
        scatter = apart.T @ apart
        if prior is None:
            covariance = scatter / count
        else:
            prior_mean, prior_covariance = prior.moments(points[:, t])
            between = mean - prior_mean
            scatter = scatter + STRENGTH * prior_covariance
            scatter += count * STRENGTH / (count + STRENGTH) * np.outer(between, between)
            covariance = scatter / (count + STRENGTH)
        covariance = covariance + jitter
        slope = np.linalg.solve(covariance[:given, :given], covariance[:given, given:]).T
        transition[t], offset[t] = slope, mean[given:] - slope @ mean[:given]
        left = covariance[given:, given:] - slope @ covariance[:given, given:]
        noise[t] = (left + left.T) / 2
    return Dynamics(transition, offset, noise)
