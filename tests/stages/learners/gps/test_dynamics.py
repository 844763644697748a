"""The mixture finds what made its points, and the regression the dynamics, from few rollouts by the mixture's help."""

import numpy as np

from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.dynamics import fit_dynamics, fit_prior, transitions
from stages.learners.gps.gmm import Mixture, fit_mixture


def drawn(n=3000, seed=0):
    """Points of a known mixture of three."""
    rng = np.random.default_rng(seed)
    root = 0.5 * rng.standard_normal((3, 4, 4))
    true = Mixture(
        np.array([0.5, 0.3, 0.2]), 4 * rng.standard_normal((3, 4)), root @ root.swapaxes(1, 2) + 0.1 * np.eye(4)
    )
    labels = rng.choice(3, n, p=true.weights)
    noise = np.einsum("nij,nj->ni", np.linalg.cholesky(true.covariances)[labels], rng.standard_normal((n, 4)))
    return true, true.means[labels] + noise


def test_a_known_mixture_is_found():
    true, points = drawn()
    found, _ = fit_mixture(points, 3, np.random.default_rng(1))
    assert found.log_likelihood(points) > true.log_likelihood(points) - 1
    _, fresh = drawn()
    order = [int(np.linalg.norm(found.means - mean, axis=1).argmin()) for mean in true.means]
    assert sorted(order) == [0, 1, 2]
    np.testing.assert_allclose(found.weights[order], true.weights, atol=0.03)
    np.testing.assert_allclose(found.means[order], true.means, atol=0.15)
    np.testing.assert_allclose(found.covariances[order], true.covariances, atol=0.15 * true.covariances.max())
    assert found.responsibilities(fresh).sum(axis=1).round(9).tolist() == [1.0] * len(fresh)


def test_no_step_lowers_the_objective_even_with_too_many_clusters_or_a_dead_dimension():
    points = drawn(300)[1]
    points = np.concatenate([points, np.full((300, 1), 2.0), points[:, :1]], axis=1)  # constant, and a copy
    for clusters in (1, 3, 12):
        found, objective = fit_mixture(points, clusters, np.random.default_rng(0))
        assert len(objective) > 1
        assert (np.diff(objective) > -1e-6 * np.abs(objective[0])).all()
        assert np.isfinite(found.log_likelihood(points))


def test_a_fit_goes_on_from_an_older_one():
    points = drawn()[1]
    first, _ = fit_mixture(points, 3, np.random.default_rng(1))
    _, objective = fit_mixture(points, 3, np.random.default_rng(2), first)
    assert len(objective) == 2, "there was nothing left to gain"
    assert len(fit_mixture(points, 4, np.random.default_rng(2), first)[0].weights) == 4, "another size starts anew"


def test_moments_are_those_of_the_clusters_where_the_points_are():
    true, points = drawn()
    mean, covariance = true.moments(points)
    np.testing.assert_allclose(mean, points.mean(axis=0), atol=0.1)
    np.testing.assert_allclose(covariance, np.cov(points.T), atol=0.05 * covariance.max())
    mean, covariance = true.moments(true.means[2:])
    np.testing.assert_allclose(mean, true.means[2], atol=1e-2)
    np.testing.assert_allclose(covariance, true.covariances[2], atol=1e-1)


def simulated(mass, roll, n, seed):
    controller = LinearGaussianController.constant(12, 4, 2, 0.5)
    rng = np.random.default_rng(seed)
    return roll(mass, controller, 0.1 * rng.standard_normal((n, 4)), rng)


def test_many_rollouts_give_the_dynamics(mass, roll):
    fitted = fit_dynamics(*simulated(mass, roll, 5000, 0))
    np.testing.assert_allclose(fitted.transition, mass.transition, atol=0.02)
    np.testing.assert_allclose(fitted.offset, mass.offset, atol=0.002)
    np.testing.assert_allclose(fitted.noise, mass.noise, atol=1e-5)


def test_the_prior_helps_where_rollouts_are_few(mass, roll):
    for seed in range(5):
        states, actions = simulated(mass, roll, 6, seed)
        prior = fit_prior(transitions(states, actions), np.random.default_rng(seed))
        errors = [np.abs(fit_dynamics(states, actions, p).transition - mass.transition).mean() for p in (None, prior)]
        assert errors[1] < 0.5 * errors[0]
