"""The linear-quadratic-Gaussian problem: backward pass, forward pass, and KL divergence between controllers.

Costs are quadratic in states and actions, l(x_t, u_t) = 1/2 x' Q_t x + q_t' x + c_t + 1/2 u' R u, so only the dynamics
are approximated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.dynamics import Dynamics


@dataclass(frozen=True)
class QuadraticCost:
    """Quadratic cost of T control steps and the final state.

    Attributes:
        hessian: State Hessians Q_t (T + 1, dx, dx).
        gradient: State gradients q_t (T + 1, dx).
        constant: Constants c_t (T + 1,).
        action: Action Hessian R (du, du).
    """

    hessian: np.ndarray
    gradient: np.ndarray
    constant: np.ndarray
    action: np.ndarray

    @classmethod
    def tracking(cls, state_size: int, targets: np.ndarray, weights: np.ndarray, action: np.ndarray) -> QuadraticCost:
        """The tracking cost 1/2 w_t |z_t - z*_t|^2 + 1/2 u' R u, where z_t are the last m entries of the state.

        Args:
            state_size: Number of entries of the state, dx.
            targets: Targets z*_t (T + 1, m).
            weights: Weights w_t (T + 1,).
            action: Action Hessian R (du, du).
        """
        steps, tracked = targets.shape
        hessian, gradient = np.zeros((steps, state_size, state_size)), np.zeros((steps, state_size))
        first = state_size - tracked
        hessian[:, first:, first:] = weights[:, None, None] * np.eye(tracked)
        gradient[:, first:] = -weights[:, None] * targets
        return cls(hessian, gradient, 0.5 * weights * np.square(targets).sum(axis=1), action)

    def of(self, states: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Costs (N,) of rollouts with states (N, T + 1, dx) and actions (N, T, du)."""
        quadratic = 0.5 * np.einsum("nti,tij,ntj->n", states, self.hessian, states)
        linear = np.einsum("nti,ti->n", states, self.gradient) + self.constant.sum()
        return quadratic + linear + 0.5 * np.einsum("nti,ij,ntj->n", actions, self.action, actions)


@dataclass(frozen=True)
class Marginals:
    """Gaussian marginals of states and actions under a controller.

    Attributes:
        state_mean: Means of the states (T + 1, dx).
        state_covariance: Covariances of the states (T + 1, dx, dx).
        action_mean: Means of the actions (T, du).
        action_covariance: Covariances of the actions (T, du, du).
        cross: Cross-covariances of state and action (T, dx, du).
    """

    state_mean: np.ndarray
    state_covariance: np.ndarray
    action_mean: np.ndarray
    action_covariance: np.ndarray
    cross: np.ndarray

    def cost(self, cost: QuadraticCost) -> float:
        """Expected cost of a rollout."""
        mean, action = self.state_mean, self.action_mean
        states = 0.5 * np.einsum("ti,tij,tj->", mean, cost.hessian, mean) + (cost.gradient * mean).sum()
        states += 0.5 * np.einsum("tij,tji->", cost.hessian, self.state_covariance) + cost.constant.sum()
        actions = np.einsum("ti,ij,tj->", action, cost.action, action)
        actions += np.einsum("ij,tji->", cost.action, self.action_covariance)
        return float(states + 0.5 * actions)


def backward(
    dynamics: Dynamics, cost: QuadraticCost, eta: float = 1.0, old: LinearGaussianController | None = None
) -> LinearGaussianController:
    """The controller that minimizes E[l] + eta KL(new || old), or E[l] - eta H(new) without `old`.

    It is the maximum-entropy controller for the cost l / eta - log p_old(u | x). Its covariance is the inverse of the
    action Hessian of the Q-function for this scaled cost (Levine and Abbeel 2014, Sec. 3).

    Args:
        dynamics: Dynamics of the T control steps.
        cost: Cost of the T control steps and the final state.
        eta: Dual variable.
        old: Reference controller of the KL divergence; None: minimize without one.
    """
    steps, size, both = dynamics.transition.shape
    gains, offsets = np.empty((steps, both - size, size)), np.empty((steps, both - size))
    covariances = np.empty((steps, both - size, both - size))
    value, slope = cost.hessian[steps] / eta, cost.gradient[steps] / eta
    for t in reversed(range(steps)):
        transition, offset = dynamics.transition[t], dynamics.offset[t]
        hessian = transition.T @ value @ transition
        gradient = transition.T @ (slope + value @ offset)
        hessian[:size, :size] += cost.hessian[t] / eta
        hessian[size:, size:] += cost.action / eta
        gradient[:size] += cost.gradient[t] / eta
        if old is not None:
            gain, precision = old.gains[t], np.linalg.inv(old.covariances[t])
            pull = np.concatenate([-gain.T, np.eye(len(gain))]) @ precision  # d/d(x, u) of u - K x - k, weighted
            hessian[:, size:] += pull
            hessian[:, :size] -= pull @ gain
            gradient -= pull @ old.offsets[t]
        hessian = (hessian + hessian.T) / 2
        factor = cho_factor(hessian[size:, size:], lower=True)
        gains[t] = -cho_solve(factor, hessian[size:, :size])
        offsets[t] = -cho_solve(factor, gradient[size:])
        covariance = cho_solve(factor, np.eye(both - size))
        covariances[t] = (covariance + covariance.T) / 2
        value = hessian[:size, :size] + hessian[:size, size:] @ gains[t]
        value = (value + value.T) / 2
        slope = gradient[:size] + hessian[:size, size:] @ offsets[t]
    return LinearGaussianController(gains, offsets, covariances)


def forward(
    dynamics: Dynamics, controller: LinearGaussianController, mean: np.ndarray, covariance: np.ndarray
) -> Marginals:
    """Marginals under `controller`, given the mean (dx,) and covariance (dx, dx) of the initial state."""
    means, covariances, action_means, action_covariances, crosses = [mean], [covariance], [], [], []
    for t in range(controller.steps):
        gain = controller.gains[t]
        cross = covariance @ gain.T
        action = gain @ mean + controller.offsets[t]
        action_covariance = gain @ cross + controller.covariances[t]
        joint = np.block([[covariance, cross], [cross.T, action_covariance]])
        transition = dynamics.transition[t]
        mean = transition @ np.concatenate([mean, action]) + dynamics.offset[t]
        covariance = transition @ joint @ transition.T + dynamics.noise[t]
        covariance = (covariance + covariance.T) / 2
        means.append(mean)
        covariances.append(covariance)
        action_means.append(action)
        action_covariances.append(action_covariance)
        crosses.append(cross)
    return Marginals(*(np.stack(each) for each in (means, covariances, action_means, action_covariances, crosses)))


def divergence(new: LinearGaussianController, old: LinearGaussianController, marginals: Marginals) -> float:
    """KL(new || old) of a rollout in nats: summed over time steps, for states distributed as in `marginals`."""
    total = 0.0
    for t in range(new.steps):
        mean, covariance = marginals.state_mean[t], marginals.state_covariance[t]
        precision = np.linalg.inv(old.covariances[t])
        gain = new.gains[t] - old.gains[t]
        apart = gain @ mean + new.offsets[t] - old.offsets[t]
        total += np.trace(precision @ new.covariances[t]) - len(apart)
        total += apart @ precision @ apart + np.trace(precision @ gain @ covariance @ gain.T)
        total += np.linalg.slogdet(old.covariances[t])[1] - np.linalg.slogdet(new.covariances[t])[1]
    return float(total / 2)


def on_part(controller: LinearGaussianController, marginals: Marginals, kept: int) -> LinearGaussianController:
    """The controller that observes only the first `kept` entries of the state.

    It is the conditional distribution of the actions given these entries, in closed form from the joint Gaussian of
    state and action at each time step. The effect of the other entries becomes part of the covariance.
    """
    gains, offsets, covariances = [], [], []
    for t in range(controller.steps):
        spread = marginals.state_covariance[t]
        part = spread[:kept, :kept] + np.diag(1e-6 * (np.diag(spread)[:kept] + 1e-6))
        gain = np.linalg.solve(part, marginals.cross[t, :kept]).T
        gains.append(gain)
        offsets.append(marginals.action_mean[t] - gain @ marginals.state_mean[t, :kept])
        # Add the effect of the other entries to the controller's noise as a Gram matrix: rounding keeps it positive.
        left = spread - spread[:, :kept] @ np.linalg.solve(part, spread[:kept])
        told, directions = np.linalg.eigh((left + left.T) / 2)
        root = controller.gains[t] @ directions * np.sqrt(np.maximum(told, 0))
        covariances.append(controller.covariances[t] + root @ root.T)
    return LinearGaussianController(np.stack(gains), np.stack(offsets), np.stack(covariances))
