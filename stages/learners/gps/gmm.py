"""A Gaussian mixture with full covariances, fitted by expectation maximization, that can continue an earlier fit.

scikit-learn's GaussianMixture can also continue an earlier fit (weights_init, means_init, precisions_init). It is not
used for two reasons. It is not a dependency (only the extra `align` installs it), and its only regularization,
reg_covar, adds the same constant to the variance of every dimension. The points here mix radians, meters, torques and
image features, so the prior below is proportional to the variance of each dimension. The prior's influence decreases
with the number of points in a cluster.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

SHRINKAGE = 1e-5  # scale of the covariance prior, as a share of the pooled variance of all points
STEPS = 30  # maximum number of EM steps
TOLERANCE = 1e-4  # EM stops when the gain of the objective per point is below this


@dataclass(frozen=True)
class Mixture:
    """A mixture of K Gaussians in D dimensions.

    Attributes:
        weights: Weights (K,) of the clusters; they sum to one.
        means: Means (K, D).
        covariances: Covariances (K, D, D).
    """

    weights: np.ndarray
    means: np.ndarray
    covariances: np.ndarray

    def log_joint(self, points: np.ndarray) -> np.ndarray:
        """Log joint densities log p(cluster, point) (N, K) of points (N, D)."""
        size = points.shape[1]
        out = np.empty((len(points), len(self.weights)))
        for k, (mean, covariance) in enumerate(zip(self.means, self.covariances, strict=True)):
            root = np.linalg.cholesky(covariance)
            whitened = solve_triangular(root, (points - mean).T, lower=True)
            log_det = 2 * np.log(np.diag(root)).sum()
            out[:, k] = -0.5 * (np.square(whitened).sum(axis=0) + log_det + size * np.log(2 * np.pi))
        return out + np.log(np.maximum(self.weights, 1e-300))

    def responsibilities(self, points: np.ndarray) -> np.ndarray:
        """Responsibilities p(cluster | point) (N, K) of points (N, D)."""
        joint = self.log_joint(points)
        return np.exp(joint - logsumexp(joint, axis=1, keepdims=True))

    def log_likelihood(self, points: np.ndarray) -> float:
        """Total log-likelihood of points (N, D)."""
        return float(logsumexp(self.log_joint(points), axis=1).sum())

    def moments(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean (D,) and covariance (D, D) of the mixture, with clusters weighted by their share of points (N, D)."""
        shares = self.responsibilities(points).mean(axis=0)
        mean = shares @ self.means
        apart = self.means - mean
        covariance = np.einsum("k,kij->ij", shares, self.covariances) + (shares[:, None] * apart).T @ apart
        return mean, covariance


def fit_mixture(
    points: np.ndarray, clusters: int, rng: np.random.Generator, start: Mixture | None = None
) -> tuple[Mixture, list[float]]:
    """Fit a mixture to points (N, D).

    Covariances have an inverse-Wishart prior whose scale is a small share of the variances of the points. It keeps the
    covariances regular if a dimension never varies. EM maximizes the log-likelihood plus the log of this prior.

    Args:
        points: Points (N, D).
        clusters: Number of clusters, K. In a fit from scratch, each point starts in the cluster of the nearest of K
            randomly drawn points.
        rng: Generator for drawing these K points.
        start: Earlier fit to continue from; ignored unless it has K clusters.

    Returns:
        The mixture and the objective before each EM step.
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
    """Responsibilities (N, K) that assign each point to the nearest of K random points, in standard deviations."""
    # Center the points: for a constant nonzero dimension, rounding errors would otherwise dominate the squares below.
    scaled = (points - points.mean(axis=0)) / (points.std(axis=0) + 1e-8)
    centres = scaled[rng.choice(len(points), clusters, replace=False)]
    squares = np.square(scaled).sum(axis=1)[:, None] - 2 * scaled @ centres.T + np.square(centres).sum(axis=1)
    return np.eye(clusters)[squares.argmin(axis=1)]


def _maximise(points: np.ndarray, shares: np.ndarray, scale: np.ndarray) -> Mixture:
    """M step: the mixture that maximizes the objective for points (N, D) with responsibilities (N, K)."""
    counts = shares.sum(axis=0)
    counted = np.maximum(counts, 1e-6)
    means = (shares.T @ points) / counted[:, None]
    covariances = np.empty((len(counts), *scale.shape))
    for k, mean in enumerate(means):
        apart = points - mean
        covariances[k] = ((shares[:, k, None] * apart).T @ apart + scale) / counted[k]
    return Mixture(counts / counts.sum(), means, covariances)
