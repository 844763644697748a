"""Backward and forward pass against Riccati equations, dm_control's solver, and rollouts."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.dynamics import Dynamics
from stages.learners.gps.lqr import QuadraticCost, backward, divergence, forward, on_part

START = np.array([0.2, -0.1, 0.0, 0.3])
SPREAD = np.diag([0.02, 0.01, 0.03, 0.01])


def unchanging(a, b, q, r, steps):
    """The same linear dynamics and cost at every step."""
    size = len(a)
    dynamics = Dynamics(
        np.tile(np.hstack([a, b]), (steps, 1, 1)), np.zeros((steps, size)), np.tile(1e-6 * np.eye(size), (steps, 1, 1))
    )
    return dynamics, QuadraticCost(np.tile(q, (steps + 1, 1, 1)), np.zeros((steps + 1, size)), np.zeros(steps + 1), r)


@pytest.mark.parametrize("eta", [1.0, 1e-3])
def test_long_horizon_gains_are_those_of_the_algebraic_riccati_equation(eta):
    rng = np.random.default_rng(0)
    a, b = 0.4 * rng.standard_normal((5, 5)), rng.standard_normal((5, 2))
    q, r = np.diag(rng.uniform(0.1, 2, 5)), np.diag([0.3, 0.7])
    value = solve_discrete_are(a, b, q, r)
    controller = backward(*unchanging(a, b, q, r, 200), eta)
    np.testing.assert_allclose(controller.gains[0], -np.linalg.solve(b.T @ value @ b + r, b.T @ value @ a), rtol=1e-8)
    np.testing.assert_allclose(controller.covariances[0], eta * np.linalg.inv(b.T @ value @ b + r), rtol=1e-8)
    np.testing.assert_allclose(controller.offsets, 0, atol=1e-12)


@pytest.mark.parametrize("level", ["lqr_2_1", "lqr_6_2"])
def test_gains_are_those_of_dm_controls_solver_on_its_own_physics(level):
    from dm_control.suite import lqr, lqr_solver

    env = getattr(lqr, level)(random=2)
    env.reset()
    physics = env.physics
    n, m = physics.model.nq, physics.model.nu
    _, gains, beta = lqr_solver.solve(env)

    def step(state, action):
        with physics.reset_context():
            physics.data.qpos[:], physics.data.qvel[:] = state[:n], state[n:]
        physics.data.ctrl[:] = action
        physics.step()
        return np.concatenate([physics.data.qpos, physics.data.qvel])

    a = np.stack([step(unit, np.zeros(m)) for unit in np.eye(2 * n)], axis=1)
    b = np.stack([step(np.zeros(2 * n), unit) for unit in np.eye(m)], axis=1)
    q = np.diag(np.concatenate([np.ones(n), np.zeros(n)]))
    steps = int(np.log(1e-5) / np.log(beta))
    controller = backward(*unchanging(a, b, q, env.task.control_cost_coef * np.eye(m), steps))
    np.testing.assert_allclose(controller.gains[0], gains, atol=1e-6 * np.abs(gains).max())


def test_no_other_controller_costs_less(mass, to_place, any_controller):
    cost = to_place(12)
    best = backward(mass, cost)

    def objective(controller):
        """What is minimised without an old controller: the expected cost less the entropy."""
        entropy = 0.5 * np.linalg.slogdet(2 * np.pi * np.e * controller.covariances)[1].sum()
        return forward(mass, controller, START, SPREAD).cost(cost) - entropy

    for seed in range(20):
        other = any_controller(seed)
        for share in (1.0, 0.01):
            mixed = LinearGaussianController(
                *(best.arrays()[k] + share * (other.arrays()[k] - best.arrays()[k]) for k in best.arrays())
            )
            assert objective(best) < objective(mixed)


def test_marginals_are_the_moments_of_rollouts(mass, any_controller, to_place, roll):
    controller, cost = any_controller(1), to_place(12)
    marginals = forward(mass, controller, START, SPREAD)
    rng = np.random.default_rng(0)
    states, actions = roll(mass, controller, rng.multivariate_normal(START, SPREAD, 100_000), rng)
    scale = np.sqrt(marginals.state_covariance.max())
    np.testing.assert_allclose(states.mean(axis=0), marginals.state_mean, atol=0.02 * scale)
    for t in (0, 5, 11):
        both = np.cov(np.concatenate([states[:, t], actions[:, t]], axis=1).T)
        np.testing.assert_allclose(both[:4, :4], marginals.state_covariance[t], atol=0.03 * scale**2)
        np.testing.assert_allclose(both[:4, 4:], marginals.cross[t], atol=0.03 * scale**2)
        np.testing.assert_allclose(both[4:, 4:], marginals.action_covariance[t], atol=0.03 * both[4:, 4:].max())
    np.testing.assert_allclose(cost.of(states, actions).mean(), marginals.cost(cost), rtol=0.01)


def test_divergence_is_what_rollouts_say(mass, any_controller, roll):
    new, old = any_controller(1), any_controller(2)
    exact = divergence(new, old, forward(mass, new, START, SPREAD))
    rng = np.random.default_rng(0)
    states, actions = roll(mass, new, rng.multivariate_normal(START, SPREAD, 100_000), rng)

    def log_probability(controller):
        total = 0.0
        for t in range(controller.steps):
            apart = actions[:, t] - controller.act(t, states[:, t])
            covariance = controller.covariances[t]
            total = total - 0.5 * np.einsum("ni,ij,nj->n", apart, np.linalg.inv(covariance), apart)
            total = total - 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
        return total

    np.testing.assert_allclose((log_probability(new) - log_probability(old)).mean(), exact, rtol=0.01)
    assert divergence(new, new, forward(mass, new, START, SPREAD)) == pytest.approx(0, abs=1e-9)


def test_the_controller_on_part_of_the_state_is_the_regression_on_it(mass, any_controller, roll):
    controller = any_controller(3)
    part = on_part(controller, forward(mass, controller, START, SPREAD), 2)
    rng = np.random.default_rng(0)
    states, actions = roll(mass, controller, rng.multivariate_normal(START, SPREAD, 100_000), rng)
    for t in (0, 6):
        seen = np.concatenate([states[:, t, :2], np.ones((len(states), 1))], axis=1)
        fitted = np.linalg.lstsq(seen, actions[:, t], rcond=None)[0]
        np.testing.assert_allclose(part.gains[t], fitted[:2].T, atol=0.06)
        left = np.cov((actions[:, t] - part.act(t, states[:, t, :2])).T)
        np.testing.assert_allclose(left, part.covariances[t], atol=0.03 * left.max())


def test_tracking_costs_half_the_weighted_squared_distance():
    rng = np.random.default_rng(0)
    targets, weights = rng.standard_normal((4, 2)), rng.uniform(0, 2, 4)
    states, actions = rng.standard_normal((6, 4, 5)), rng.standard_normal((6, 3, 2))
    cost = QuadraticCost.tracking(5, targets, weights, 0.1 * np.eye(2))
    by_hand = 0.5 * (weights * np.square(states[:, :, 3:] - targets).sum(axis=2)).sum(axis=1)
    np.testing.assert_allclose(cost.of(states, actions), by_hand + 0.05 * np.square(actions).sum(axis=(1, 2)))
