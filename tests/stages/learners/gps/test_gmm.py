"""The mixture of Gaussians against scipy's densities and scikit-learn's expectation maximisation."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from stages.learners.gps import gmm
from stages.learners.gps.gmm import Mixture, fit_mixture


def some_mixture(seed: int = 0, clusters: int = 3, size: int = 4) -> Mixture:
    rng = np.random.default_rng(seed)
    root = 0.5 * rng.standard_normal((clusters, size, size))
    weights = rng.uniform(0.2, 1.0, clusters)
    means = 2 * rng.standard_normal((clusters, size))
    return Mixture(weights / weights.sum(), means, root @ root.swapaxes(1, 2) + 0.1 * np.eye(size))


def some_points(mixture: Mixture, n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    labels = rng.choice(len(mixture.weights), n, p=mixture.weights)
    drawn = [rng.multivariate_normal(mixture.means[label], mixture.covariances[label]) for label in labels]
    return np.stack(drawn)


def densities(mixture: Mixture, points: np.ndarray) -> np.ndarray:
    """p(cluster, point), (N, K), by scipy."""
    each = zip(mixture.weights, mixture.means, mixture.covariances, strict=True)
    return np.stack([weight * multivariate_normal(mean, cov).pdf(points) for weight, mean, cov in each], axis=1)


def test_densities_are_scipys():
    mixture = some_mixture()
    points = some_points(mixture, 20)
    joint = densities(mixture, points)
    np.testing.assert_allclose(np.exp(mixture.log_joint(points)), joint, rtol=1e-10)
    np.testing.assert_allclose(mixture.responsibilities(points), joint / joint.sum(axis=1, keepdims=True), rtol=1e-10)
    assert mixture.log_likelihood(points) == pytest.approx(np.log(joint.sum(axis=1)).sum())


def test_an_empty_cluster_takes_no_point():
    mixture = some_mixture()
    mixture = Mixture(np.array([0.4, 0.6, 0.0]), mixture.means, mixture.covariances)
    shares = mixture.responsibilities(mixture.means)
    assert np.isfinite(shares).all() and shares[:, 2].max() < 1e-9


def test_moments_are_those_of_the_clusters_weighted_by_how_many_points_are_theirs():
    mixture = some_mixture()
    points = np.concatenate([np.repeat(mixture.means[:1], 3, axis=0), mixture.means[1:2]])
    apart = Mixture(mixture.weights, mixture.means, 1e-4 * mixture.covariances)  # each point is its cluster's own
    mean, covariance = apart.moments(points)
    np.testing.assert_allclose(mean, 0.75 * mixture.means[0] + 0.25 * mixture.means[1])
    between = mixture.means[0] - mixture.means[1]
    within = 0.75 * apart.covariances[0] + 0.25 * apart.covariances[1]
    np.testing.assert_allclose(covariance, within + 0.75 * 0.25 * np.outer(between, between))


def test_the_m_step_is_weighted_means_and_covariances():
    rng = np.random.default_rng(0)
    points, shares = rng.normal(size=(30, 3)), rng.dirichlet(np.ones(4), 30)
    scale = np.diag([0.1, 0.2, 0.3])
    found = gmm._maximise(points, shares, scale)
    np.testing.assert_allclose(found.weights, shares.mean(axis=0))
    for k in range(4):
        np.testing.assert_allclose(found.means[k], np.average(points, axis=0, weights=shares[:, k]))
        spread = np.cov(points.T, aweights=shares[:, k], ddof=0) + scale / shares[:, k].sum()
        np.testing.assert_allclose(found.covariances[k], spread)


def test_a_cluster_that_no_point_is_of_stays_finite():
    shares = np.zeros((5, 2))
    shares[:, 0] = 1.0
    found = gmm._maximise(np.random.default_rng(0).normal(size=(5, 2)), shares, np.eye(2))
    np.testing.assert_array_equal(found.weights, [1.0, 0.0])
    assert np.isfinite(found.means).all()
    np.testing.assert_allclose(found.covariances[1], 1e6 * np.eye(2))


def test_expectation_maximisation_is_scikit_learns(monkeypatch):
    from sklearn.mixture import GaussianMixture

    true = some_mixture()
    points, start = some_points(true, 400), some_mixture(seed=1)
    monkeypatch.setattr(gmm, "SHRINKAGE", 0.0)
    monkeypatch.setattr(gmm, "TOLERANCE", -np.inf)
    for steps in (1, 7):
        monkeypatch.setattr(gmm, "STEPS", steps)
        found, objective = fit_mixture(points, 3, np.random.default_rng(0), start)
        reference = GaussianMixture(
            3, weights_init=start.weights, means_init=start.means, precisions_init=np.linalg.inv(start.covariances),
            reg_covar=0.0, max_iter=steps, tol=0.0,
        )  # fmt: skip
        with pytest.warns(Warning, match="converge"):
            reference.fit(points)
        assert len(objective) == steps
        np.testing.assert_allclose(found.weights, reference.weights_, rtol=1e-6)
        np.testing.assert_allclose(found.means, reference.means_, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(found.covariances, reference.covariances_, rtol=1e-6, atol=1e-8)
        assert objective[0] == pytest.approx(np.log(densities(start, points).sum(axis=1)).sum(), rel=1e-9)


def test_the_objective_counts_the_prior_on_covariances():
    start = some_mixture()
    points = some_points(start, 200)
    _, objective = fit_mixture(points, 3, np.random.default_rng(0), start)
    scale = np.diag(gmm.SHRINKAGE * (points.var(axis=0) + 1e-10))
    prior = -0.5 * sum(np.trace(np.linalg.inv(covariance) @ scale) for covariance in start.covariances)
    assert objective[0] - start.log_likelihood(points) == pytest.approx(prior, rel=1e-5)


def test_stops_where_a_step_gains_little_and_at_the_latest_after_thirty(monkeypatch):
    points = some_points(some_mixture(), 300)
    _, objective = fit_mixture(points, 3, np.random.default_rng(0))
    gains = np.diff(objective) / len(points)
    assert len(objective) < 30 and gains[-1] < 1e-4 and (gains[:-1] >= 1e-4).all()
    monkeypatch.setattr(gmm, "TOLERANCE", -np.inf)
    assert len(fit_mixture(points, 3, np.random.default_rng(0))[1]) == 30


def test_points_start_with_the_nearest_of_some_in_standard_deviations():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(60, 3)) * [1.0, 100.0, 0.01]
    shares = gmm._nearest(points, 4, np.random.default_rng(5))
    chosen = np.random.default_rng(5).choice(60, 4, replace=False)
    scaled = points / points.std(axis=0)
    nearest = np.linalg.norm(scaled[:, None] - scaled[chosen], axis=2).argmin(axis=1)
    np.testing.assert_array_equal(shares, np.eye(4)[nearest])
    constant = np.concatenate([points, np.ones((60, 1))], axis=1)
    np.testing.assert_array_equal(gmm._nearest(constant, 4, np.random.default_rng(5)), shares)


def test_a_dimension_that_never_varies_leaves_no_covariance_singular():
    points = np.concatenate([np.random.default_rng(0).normal(size=(50, 2)), np.full((50, 1), 3.0)], axis=1)
    found, _ = fit_mixture(points, 2, np.random.default_rng(0))
    assert (np.linalg.eigvalsh(found.covariances) > 0).all()
    np.testing.assert_allclose(found.means[:, 2], 3.0)
