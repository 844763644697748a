"""A mixture of Gaussians with full covariances, fitted by expectation maximisation, that can continue an older fit.

scikit-learn's GaussianMixture can continue an older fit as well (weights_init, means_init, precisions_init). It is not
used because it is not a dependency (only the extra `align` brings it), and because its only regularisation, reg_covar,
adds one constant to the variance of every dimension. The points here mix radians, metres, torques and image features:
the prior below is in proportion to the variance of each dimension, and weighs less in clusters of more points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

SHRINKAGE = 1e-5  # of the points' pooled variance: what the prior on covariances adds up to in a cluster of one point
STEPS = 30  # of EM at most
TOLERANCE = 1e-4  # a gain of the objective a point below which EM stops


@dataclass(frozen=True)
class Mixture:
    """A mixture of K Gaussians in D dimensions.

    Attributes:
        weights: Of the clusters (K,), summing to one.
        means: (K, D).
        covariances: (K, D, D).
    """

    weights: np.ndarray
    means: np.ndarray
    covariances: np.ndarray

    def log_joint(self, points: np.ndarray) -> np.ndarray:
        """log p(cluster, point), (N, K), of points (N, D)."""
        size = points.shape[1]
        out = np.empty((len(points), len(self.weights)))
        for k, (mean, covariance) in enumerate(zip(self.means, self.covariances, strict=True)):
            root = np.linalg.cholesky(covariance)
            whitened = solve_triangular(root, (points - mean).T, lower=True)
            log_det = 2 * np.log(np.diag(root)).sum()
            out[:, k] = -0.5 * (np.square(whitened).sum(axis=0) + log_det + size * np.log(2 * np.pi))
        return out + np.log(np.maximum(self.weights, 1e-300))

    def responsibilities(self, points: np.ndarray) -> np.ndarray:
        """p(cluster | point), (N, K), of points (N, D)."""
        joint = self.log_joint(points)
        return np.exp(joint - logsumexp(joint, axis=1, keepdims=True))

    def log_likelihood(self, points: np.ndarray) -> float:
        """Of points (N, D), summed."""
        return float(logsumexp(self.log_joint(points), axis=1).sum())

    def moments(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean (D,) and covariance (D, D) of the clusters that points (N, D) belong to, weighted by how many do."""
        shares = self.responsibilities(points).mean(axis=0)
        mean = shares @ self.means
        apart = self.means - mean
        covariance = np.einsum("k,kij->ij", shares, self.covariances) + (shares[:, None] * apart).T @ apart
        return mean, covariance


def fit_mixture(
    points: np.ndarray, clusters: int, rng: np.random.Generator, start: Mixture | None = None
) -> tuple[Mixture, list[float]]:
    """Fit a mixture to points (N, D).

    Covariances have an inverse-Wishart prior whose scale is a little of the points' own variances, so that a dimension
    which never varies leaves none singular; what EM raises is the log-likelihood plus the log of that prior.

    Args:
        points: (N, D).
        clusters: K, of a fit from scratch: each point starts in the cluster of the nearest of K random points.
        rng: Draws those.
        start: An older fit to go on from, if it has K clusters.

    Returns:
        The mixture, and the objective before each step of EM.
    """
    scale = np.diag(SHRINKAGE * (points.var(axis=0) + 1e-10))
    if start is not None and len(start.weights) == clusters:
        mixture = start
    else:
        mixture = _maximise(points, _nearest(points, clusters, rng), scale)
    objective: list[float] = []
    for _ in range(STEPS):
        joint = mixture.log_joint(points)
        evidence = logsumexp(joint, axis=1, keepdims=True)
        prior = -0.5 * sum(np.trace(np.linalg.solve(each, scale)) for each in mixture.covariances)
        objective.append(float(evidence.sum() + prior))
        if len(objective) > 1 and objective[-1] - objective[-2] < TOLERANCE * len(points):
            break
        mixture = _maximise(points, np.exp(joint - evidence), scale)
    return mixture, objective


def _nearest(points: np.ndarray, clusters: int, rng: np.random.Generator) -> np.ndarray:
    """Responsibilities (N, K): each point belongs to the nearest, in standard deviations, of K of them."""
    # Centred: the squares below would otherwise drown in rounding where a dimension is constant and not zero.
    scaled = (points - points.mean(axis=0)) / (points.std(axis=0) + 1e-8)
    centres = scaled[rng.choice(len(points), clusters, replace=False)]
    squares = np.square(scaled).sum(axis=1)[:, None] - 2 * scaled @ centres.T + np.square(centres).sum(axis=1)
    return np.eye(clusters)[squares.argmin(axis=1)]


def _maximise(points: np.ndarray, shares: np.ndarray, scale: np.ndarray) -> Mixture:
    """The M step: the mixture that points (N, D) with responsibilities (N, K) make likeliest."""
    counts = shares.sum(axis=0)
    counted = np.maximum(counts, 1e-6)
    means = (shares.T @ points) / counted[:, None]
    covariances = np.empty((len(counts), *scale.shape))
    for k, mean in enumerate(means):
        apart = points - mean
        covariances[k] = ((shares[:, k, None] * apart).T @ apart + scale) / counted[k]
    return Mixture(counts / counts.sum(), means, covariances)
