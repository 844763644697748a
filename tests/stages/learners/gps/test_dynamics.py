"""The mixture finds what made its points, and the regression the dynamics, from few rollouts by the mixture's help."""

import dataclasses

import numpy as np
import pytest

from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.dynamics import fit_dynamics, fit_prior, neighbours, transitions
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
    order = [int(np.linalg.norm(found.means - mean, axis=1).argmin()) for mean in true.means]
    assert sorted(order) == [0, 1, 2]
    np.testing.assert_allclose(found.weights[order], true.weights, atol=0.03)
    np.testing.assert_allclose(found.means[order], true.means, atol=0.15)
    np.testing.assert_allclose(found.covariances[order], true.covariances, atol=0.15 * true.covariances.max())
    belongs = np.array(order)[true.responsibilities(points).argmax(axis=1)]
    assert (found.responsibilities(points).argmax(axis=1) == belongs).mean() > 0.97


def test_fit_and_densities_are_those_of_scikit_learn():
    mixture = pytest.importorskip("sklearn.mixture")
    _, points = drawn(500)
    start, _ = fit_mixture(points, 3, np.random.default_rng(1))
    start = dataclasses.replace(start, means=start.means + 0.3)
    found, _ = fit_mixture(points, 3, np.random.default_rng(1), start)
    reference = mixture.GaussianMixture(
        3,
        tol=1e-4,
        reg_covar=1e-9,
        weights_init=start.weights,
        means_init=start.means,
        precisions_init=np.linalg.inv(start.covariances),
    ).fit(points)
    np.testing.assert_allclose(found.weights, reference.weights_, atol=1e-3)
    np.testing.assert_allclose(found.means, reference.means_, atol=1e-2)
    np.testing.assert_allclose(found.covariances, reference.covariances_, atol=1e-2)
    same = Mixture(reference.weights_, reference.means_, reference.covariances_)
    assert np.isclose(same.log_likelihood(points), reference.score(points) * len(points))
    np.testing.assert_allclose(same.responsibilities(points), reference.predict_proba(points), atol=1e-9)


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


def unrelated(states, rng, count):
    """States with `count` more entries, which wander by themselves."""
    noise = 0.01 * rng.standard_normal((*states.shape[:2], count))
    return np.concatenate([states, noise.cumsum(axis=1)], axis=2)


def test_neighbours_and_shrunk_slopes_help_where_the_state_has_many_numbers_more(mass, roll):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        states, actions = simulated(mass, roll, 6, seed)
        states = unrelated(states, rng, 40)
        prior = fit_prior(transitions(states, actions), rng)
        errors = []
        for period in (None, 1):
            slopes = fit_dynamics(states, actions, prior, period).transition[:, :4]
            wrong = np.abs(slopes[:, :, :4] - mass.transition[:, :, :4]).mean()
            errors.append(wrong + np.abs(slopes[:, :, 4:-2]).mean())
        assert errors[1] < 0.5 * errors[0]


def test_earlier_rollouts_help_and_move_nothing_that_is_predicted_of_the_present_mean(mass, roll):
    for seed in range(5):
        states, actions = simulated(mass, roll, 4, seed)
        moved = LinearGaussianController.constant(12, 4, 2, 0.5)
        moved = dataclasses.replace(moved, offsets=moved.offsets + 0.3)
        rng = np.random.default_rng(seed + 100)
        old = [transitions(*roll(mass, moved, 0.1 * rng.standard_normal((4, 4)), rng)) for _ in range(3)]
        prior = fit_prior(transitions(states, actions), rng)
        fits = [fit_dynamics(states, actions, prior, None, earlier) for earlier in ((), old)]
        errors = [np.abs(fit.transition - mass.transition).mean() for fit in fits]
        assert errors[1] < 0.8 * errors[0]
        points = transitions(states, actions).mean(axis=0)
        after = np.einsum("tij,tj->ti", fits[1].transition, points[:, :-4]) + fits[1].offset
        np.testing.assert_allclose(after, points[:, -4:], atol=1e-9)


def test_noise_is_what_the_dynamics_leave_over(mass, roll):
    states, actions = simulated(mass, roll, 20, 0)
    states = unrelated(states, np.random.default_rng(0), 8)
    fitted = fit_dynamics(states, actions, fit_prior(transitions(states, actions), np.random.default_rng(0)))
    assert np.linalg.eigvalsh(fitted.noise).min() > 0
    assert np.abs(fitted.noise - fitted.noise.swapaxes(1, 2)).max() < 1e-12
    left = states[:, 1:] - states[:, :-1]
    assert (np.diagonal(fitted.noise, axis1=1, axis2=2).mean(axis=0)[4:] > 0.3 * left.var(axis=(0, 1))[4:]).all()


def test_neighbours_in_time_are_those_at_the_same_place_between_two_frames():
    shares = neighbours(9, 2)
    np.testing.assert_array_equal(shares, shares.T)
    np.testing.assert_array_equal(np.diag(shares), 1)
    assert set(np.flatnonzero(shares[4])) == {0, 2, 4, 6, 8}
    assert shares[4, 2] > shares[4, 0] > 0
    assert set(np.flatnonzero(neighbours(9, 1)[4])) == {2, 3, 4, 5, 6}
