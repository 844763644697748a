"""The fitted dynamics equal their definition, written out time step by time step."""

import numpy as np
import pytest

from stages.learners.gps import dynamics as module
from stages.learners.gps.dynamics import fit_dynamics, fit_prior, neighbours, transitions
from stages.learners.gps.gmm import Mixture

N, T, DX, DU = 7, 5, 3, 2
BOTH = 2 * DX + DU


def rollouts(seed: int = 0, n: int = N) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, T + 1, DX)).cumsum(axis=1), rng.normal(size=(n, T, DU))


def conditional(mean: np.ndarray, covariance: np.ndarray, given: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slope, offset and noise of the last entries given the first `given`, of a Gaussian."""
    slope = covariance[given:, :given] @ np.linalg.inv(covariance[:given, :given])
    offset = mean[given:] - slope @ mean[:given]
    return slope, offset, covariance[given:, given:] - slope @ covariance[:given, given:]


def jitter(points: np.ndarray) -> np.ndarray:
    return np.diag(1e-6 * (points.reshape(-1, BOTH).var(axis=0) + 1e-6))


def check(found, t, mean, covariance):
    slope, offset, noise = conditional(mean, covariance, DX + DU)
    np.testing.assert_allclose(found.transition[t], slope, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.offset[t], offset, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.noise[t], noise, rtol=1e-5, atol=1e-9)


def test_a_transition_is_state_action_and_next_state():
    states, actions = rollouts()
    points = transitions(states, actions)
    assert points.shape == (N, T, BOTH)
    np.testing.assert_array_equal(points[2, 3], [*states[2, 3], *actions[2, 3], *states[2, 4]])


def test_without_a_prior_it_is_least_squares():
    states, actions = rollouts(n=40)
    found, points = fit_dynamics(states, actions), transitions(states, actions)
    for t in range(T):
        check(found, t, points[:, t].mean(axis=0), np.cov(points[:, t].T, ddof=0) + jitter(points))
        regressors = np.concatenate([points[:, t, : DX + DU], np.ones((40, 1))], axis=1)
        fitted = np.linalg.lstsq(regressors, points[:, t, DX + DU :], rcond=None)[0]
        np.testing.assert_allclose(found.transition[t], fitted[:-1].T, atol=1e-4)
        np.testing.assert_allclose(found.offset[t], fitted[-1], atol=1e-4)


def test_the_prior_is_normal_inverse_wishart():
    """It counts as one rollout: its covariance, and how far its mean is from the rollouts' (Levine et al., A.3)."""
    states, actions = rollouts()
    points = transitions(states, actions)
    rng = np.random.default_rng(1)
    root = rng.normal(size=(BOTH, BOTH))
    prior = Mixture(np.ones(1), 3 * rng.normal(size=(1, BOTH)), (root @ root.T)[None])
    found = fit_dynamics(states, actions, prior)
    for t in range(T):
        mean = points[:, t].mean(axis=0)
        scatter = np.cov(points[:, t].T, ddof=0) * N + prior.covariances[0]
        scatter += N * 1 / (N + 1) * np.outer(mean - prior.means[0], mean - prior.means[0])
        check(found, t, mean, scatter / (N + 1) + jitter(points))


def weight_of(points: np.ndarray, t: int, recalled: np.ndarray) -> float:
    """What nearness to the present rollouts makes of an earlier rollout's weight."""
    apart = np.square(recalled[:, t] - points[:, t].mean(axis=0)).mean(axis=0)
    far = (apart / (points[:, t].var(axis=0) + np.diag(jitter(points)))).mean()
    return min(1.0, 1 / far)


def test_earlier_rollouts_count_less_the_older_and_the_farther_off_they_are():
    states, actions = rollouts()
    points = transitions(states, actions)
    near = points + 0.1 * np.random.default_rng(1).normal(size=points.shape) * points.std(axis=0)
    centre = points.mean(axis=0)
    narrow, far = centre + 0.5 * (near - centre), transitions(*rollouts(3, 4)) + 2.0
    for recalled in (narrow, far):
        weights = [weight_of(points, t, recalled) for t in range(T)]
        assert all(weight == 1.0 for weight in weights) if recalled is narrow else max(weights) < 1
    found = fit_dynamics(states, actions, earlier=(narrow, far))
    for t in range(T):
        mean, scatter, total = points[:, t].mean(axis=0), np.zeros((BOTH, BOTH)), 0.0
        for age, recalled in enumerate((points, narrow, far)):
            weight = 0.6**age * (weight_of(points, t, recalled) if age else 1.0)
            apart = recalled[:, t] - mean
            scatter += weight * apart.T @ apart
            total += weight * len(recalled)
        check(found, t, mean, scatter / total + jitter(points))


@pytest.mark.parametrize("period", [1, 2])
def test_with_images_neighbours_count_and_changes_have_shrunk_slopes(period):
    states, actions = rollouts()
    points = transitions(states, actions)
    rng = np.random.default_rng(1)
    root = rng.normal(size=(BOTH, BOTH))
    prior = Mixture(np.ones(1), 3 * rng.normal(size=(1, BOTH)), (root @ root.T)[None])
    found = fit_dynamics(states, actions, prior, period)
    for t in range(T):
        scatter, total = prior.covariances[0].copy(), 1.0
        for s in range(T):
            periods, between = divmod(abs(s - t), period)
            if not between and periods <= 2:
                scatter += 0.7**periods * N * np.cov(points[:, s].T, ddof=0)
                total += 0.7**periods * N
        covariance = scatter / total + jitter(points)
        known, given = covariance[: DX + DU, : DX + DU], DX + DU
        change = covariance[given:, :given] - covariance[:DX, :given]  # of x' - x with (x, u)
        slope = change @ np.linalg.inv(known + 0.1 * np.diag(np.diag(known)))
        slope[:, :DX] += np.eye(DX)
        np.testing.assert_allclose(found.transition[t], slope, rtol=1e-6, atol=1e-9)
        mean = points[:, t].mean(axis=0)
        np.testing.assert_allclose(found.offset[t], mean[given:] - slope @ mean[:given], rtol=1e-6, atol=1e-9)
        left = np.concatenate([-slope, np.eye(DX)], axis=1)
        np.testing.assert_allclose(found.noise[t], left @ covariance @ left.T, rtol=1e-6, atol=1e-9)


def test_how_much_neighbours_count():
    row = [0, 0, 0.49, 0, 0.7, 0, 1, 0, 0.7, 0, 0.49, 0, 0]
    np.testing.assert_allclose(neighbours(13, 2)[6], row)
    np.testing.assert_allclose(
        neighbours(5, 1), [[0.7 ** abs(i - j) * (abs(i - j) <= 2) for j in range(5)] for i in range(5)]
    )


@pytest.mark.parametrize(("count", "clusters"), [(7, 1), (8, 1), (15, 1), (16, 2), (200, 20)])
def test_the_prior_has_a_cluster_for_every_forty_points_and_twenty_at_most(count, clusters):
    points = transitions(*rollouts(n=count))
    prior = fit_prior(points, np.random.default_rng(0))
    assert len(prior.weights) == clusters
    assert prior.means.shape == (clusters, BOTH)


def test_the_prior_goes_on_from_the_one_before(monkeypatch):
    points, asked = transitions(*rollouts(n=16)), []
    fit = module.fit_mixture
    monkeypatch.setattr(module, "fit_mixture", lambda *given: asked.append(given) or fit(*given))
    first = fit_prior(points, np.random.default_rng(0))
    second = fit_prior(points, np.random.default_rng(1), first)
    np.testing.assert_array_equal(asked[0][0], points.reshape(-1, BOTH))
    assert asked[1][3] is first
    assert second.log_likelihood(points.reshape(-1, BOTH)) >= first.log_likelihood(points.reshape(-1, BOTH)) - 1
