"""One iteration of the trajectory-centric learner of guided policy search: from rollouts to the next controller.

The iteration fits dynamics around the rollouts. Then it minimizes the expected cost subject to a bound on the KL
divergence from the controller that produced the rollouts: LQR solves the Lagrangian, and bisection finds the dual
variable (Levine and Abbeel 2014, Sec. 3; Levine et al. 2016, Sec. 4.1). The step size of the next iteration depends on
how well the gain of this iteration was predicted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.dynamics import Dynamics, fit_dynamics, fit_prior, transitions
from stages.learners.gps.gmm import Mixture
from stages.learners.gps.lqr import Marginals, QuadraticCost, backward, divergence, forward

REMEMBERED = 60  # maximum number of rollouts that the prior of the dynamics is fitted to
TOLERANCE = 0.05  # relative tolerance with which the KL divergence meets the bound
BISECTIONS = 60
LEAST_ETA, MOST_ETA = 1e-10, 1e14
STEP_CHANGE = (0.1, 5.0)  # minimum and maximum change of the step size per iteration, as factors
STEP_RANGE = (0.05, 10.0)  # minimum and maximum step size, relative to the bound set by the user
LEAST_VARIANCE = 1e-8  # minimum variance of the initial state, in squared units of the state


@dataclass(frozen=True)
class Improvement:
    """Result of an iteration.

    Attributes:
        controller: The next controller.
        marginals: Marginals of the next controller under the fitted dynamics.
        divergence: KL divergence from the old controller over a whole rollout, in nats.
        bound: Bound on the divergence, in nats.
        eta: Dual variable.
        binding: Whether the bound is active.
        seen: Marginals of the old controller: means of its rollouts, covariances under the fitted dynamics.
    """

    controller: LinearGaussianController
    marginals: Marginals
    divergence: float
    bound: float
    eta: float
    binding: bool
    seen: Marginals | None = None


@dataclass(frozen=True)
class Search:
    """Complete state of a search.

    Attributes:
        controller: Controller for the next rollouts.
        step: Bound on the KL divergence per control step, relative to the bound set by the user.
        states: States (N, T + 1, dx) of remembered rollouts, newest last.
        actions: Actions (N, T, du) of remembered rollouts.
        mixture: Prior of the dynamics; None before the first iteration.
        predicted: Expected cost before the last update and predicted cost after it; None before the first update.
    """

    controller: LinearGaussianController
    step: float = 1.0
    states: np.ndarray = field(default_factory=lambda: np.empty(0))
    actions: np.ndarray = field(default_factory=lambda: np.empty(0))
    mixture: Mixture | None = None
    predicted: tuple[float, float] | None = None


def iterate(
    search: Search,
    states: np.ndarray,
    actions: np.ndarray,
    cost: QuadraticCost,
    kl: float,
    rng: np.random.Generator,
    least_std: float = 0.0,
    period: int | None = None,
) -> tuple[Search, Improvement]:
    """Update the controller from rollouts of `search.controller`.

    Args:
        search: State of the search.
        states: States (N, T + 1, dx).
        actions: Actions (N, T, du) before clipping, so that the fitted dynamics include the limits of the motors.
        cost: Cost to minimize.
        kl: Bound on the KL divergence of an update per control step, in nats; scaled by the adaptive step size.
        rng: Generator for initializing the mixture.
        least_std: Minimum standard deviation of the next controller's actions.
        period: Control steps per frame if the state contains image features, else None.

    Returns:
        The next state of the search and the result of the iteration.
    """
    earlier: list[np.ndarray] = []
    if len(search.states):
        past = transitions(search.states, search.actions)
        earlier = [past[max(end - len(states), 0) : end] for end in range(len(past), 0, -len(states))]
        remembered = np.concatenate([search.states, states])[-REMEMBERED:]
        done = np.concatenate([search.actions, actions])[-REMEMBERED:]
    else:
        remembered, done = states, actions
    mixture = fit_prior(transitions(remembered, done), rng, search.mixture)
    dynamics = fit_dynamics(states, actions, mixture, period, earlier)
    mean = states[:, 0].mean(axis=0)
    apart = states[:, 0] - mean
    covariance = apart.T @ apart / len(states) + LEAST_VARIANCE * np.eye(len(mean))
    before = forward(dynamics, search.controller, mean, covariance)
    now = before.cost(cost)
    step = search.step
    if search.predicted is not None:
        step = float(np.clip(step * step_change(*search.predicted, now), *STEP_RANGE))
    found = improve(dynamics, cost, search.controller, mean, covariance, kl * step * actions.shape[1], least_std)
    predicted = (now, found.marginals.cost(cost))
    return replace(
        search,
        controller=found.controller,
        step=step,
        states=remembered,
        actions=done,
        mixture=mixture,
        predicted=predicted,
    ), replace(found, seen=replace(before, state_mean=states.mean(axis=0), action_mean=actions.mean(axis=0)))


def step_change(before: float, predicted: float, actual: float) -> float:
    """Factor for the step size, from the cost before an update, the predicted cost and the actual cost after it.

    If the actual gain is below the predicted gain by an error that is quadratic in the step size, the factor is half
    the ratio of predicted gain to shortfall, which maximizes the gain (Levine et al. 2016, appendix A.2).
    """
    promised, gained = before - predicted, before - actual
    short = max(promised - gained, 1e-4 * abs(promised), 1e-12)
    return float(np.clip(promised / (2 * short), *STEP_CHANGE))


def improve(
    dynamics: Dynamics,
    cost: QuadraticCost,
    old: LinearGaussianController,
    mean: np.ndarray,
    covariance: np.ndarray,
    bound: float,
    least_std: float = 0.0,
) -> Improvement:
    """Minimize the expected cost subject to KL(new || old) <= `bound` over a rollout.

    The divergence decreases as the dual variable increases. If the divergence is below the bound even for the smallest
    dual variable, that solution is returned.

    Args:
        dynamics: Fitted dynamics.
        cost: Cost to minimize.
        old: Controller that produced the rollouts.
        mean: Mean of the initial state (dx,).
        covariance: Covariance of the initial state (dx, dx).
        bound: Bound on the divergence, in nats.
        least_std: Minimum standard deviation of the new controller's actions in every direction; the divergence
            includes its effect.
    """

    def attempt(eta: float) -> Improvement:
        controller = backward(dynamics, cost, eta, old)
        if least_std:
            controller = controller.widened(least_std)
        marginals = forward(dynamics, controller, mean, covariance)
        found = divergence(controller, old, marginals)
        return Improvement(controller, marginals, found, bound, eta, binding=True)

    with np.errstate(over="ignore", invalid="ignore"):
        return _bisect(attempt, bound)


def _bisect(attempt: Callable[[float], Improvement], bound: float) -> Improvement:
    """The attempt whose divergence is at most `bound` and equal to it within the tolerance, if there is one."""
    low, high = np.log(LEAST_ETA), np.log(MOST_ETA)
    best: Improvement | None = None
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        try:
            found = attempt(float(np.exp(middle)))
        except (np.linalg.LinAlgError, ValueError):  # Eta is so small that the Hessian is numerically indefinite.
            low = middle
            continue
        if not found.divergence <= bound:  # also true for NaN
            low = middle
            continue
        high, best = middle, found
        if found.divergence >= (1 - TOLERANCE) * bound:
            return found
    best = best or attempt(MOST_ETA)
    return replace(best, binding=False)
