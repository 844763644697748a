"""Linear systems whose dynamics are known."""

import numpy as np
import pytest

from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.dynamics import Dynamics
from stages.learners.gps.lqr import QuadraticCost


def point_mass(steps, dt=0.1, noise=1e-4):
    """A mass in the plane, pushed by two forces: x = (place, velocity)."""
    eye, zero = np.eye(2), np.zeros((2, 2))
    transition = np.block([[eye, dt * eye, 0.5 * dt**2 * eye], [zero, 0.98 * eye, dt * eye]])
    return Dynamics(
        np.tile(transition, (steps, 1, 1)),
        np.tile([0.0, 0.0, 0.0, -0.01], (steps, 1)),
        np.tile(noise * np.eye(4), (steps, 1, 1)),
    )


def rollouts(dynamics, controller, starts, rng):
    """Rollouts of linear-Gaussian dynamics: states (N, T + 1, dx), actions (N, T, du)."""
    states, actions = [starts], []
    for t in range(controller.steps):
        actions.append(
            controller.sample(t, states[-1], rng.standard_normal((len(starts), controller.offsets.shape[1])))
        )
        noise = rng.multivariate_normal(np.zeros(starts.shape[1]), dynamics.noise[t], len(starts), method="cholesky")
        both = np.concatenate([states[-1], actions[-1]], axis=1)
        states.append(both @ dynamics.transition[t].T + dynamics.offset[t] + noise)
    return np.stack(states, axis=1), np.stack(actions, axis=1)


@pytest.fixture
def mass():
    """Twelve steps of the point mass."""
    return point_mass(12)


@pytest.fixture
def roll():
    return rollouts


@pytest.fixture
def any_controller():
    """A function that makes some controller or other of the point mass."""

    def make(seed, steps=12):
        rng = np.random.default_rng(seed)
        root = 0.3 * rng.standard_normal((steps, 2, 2))
        return LinearGaussianController(
            0.3 * rng.standard_normal((steps, 2, 4)),
            0.3 * rng.standard_normal((steps, 2)),
            root @ root.swapaxes(1, 2) + 0.2 * np.eye(2),
        )

    return make


@pytest.fixture
def to_place():
    """Bring the point mass to (1, -1): a cost on the whole state, places last."""

    def make(steps):
        hessian = np.tile(np.diag([1.0, 1.0, 0.1, 0.1]), (steps + 1, 1, 1))
        target = np.array([1.0, -1.0, 0.0, 0.0])
        return QuadraticCost(
            hessian, -hessian @ target, 0.5 * np.einsum("i,tij,j->t", target, hessian, target), 0.05 * np.eye(2)
        )

    return make
