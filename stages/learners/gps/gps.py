"""One iteration of guided policy search's trajectory-centric learner: from rollouts to the next controller.

Fit the dynamics around the rollouts, then minimise the expected cost under a bound on the KL divergence from the
controller that made them, by LQR on a Lagrangian whose dual variable bisection finds (Levine and Abbeel 2014, Sec. 3;
Levine et al. 2016, Sec. 4.1). How far the next iteration may go follows from how well this one's gain was foretold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.dynamics import Dynamics, fit_dynamics, fit_prior, transitions
from stages.learners.gps.gmm import Mixture
from stages.learners.gps.lqr import Marginals, QuadraticCost, backward, divergence, forward

REMEMBERED = 60  # rollouts at most that the prior of the dynamics is fitted to
TOLERANCE = 0.05  # of the bound: how near the KL divergence comes to it
BISECTIONS = 60
LEAST_ETA, MOST_ETA = 1e-10, 1e14
STEP_CHANGE = (0.1, 5.0)  # what the step is multiplied by from one iteration to the next, at least and at most
STEP_RANGE = (0.05, 10.0)  # the step over the one that the user asked for
LEAST_VARIANCE = 1e-8  # of an initial state, in its own units


@dataclass(frozen=True)
class Improvement:
    """What an iteration found.

    Attributes:
        controller: The next controller.
        marginals: What the fitted dynamics foretell of it.
        divergence: KL from the old controller, of a whole rollout, nats.
        bound: What it may be at most.
        eta: The dual variable.
        binding: Whether the bound is what stopped it.
        seen: Of the old controller: the means of its rollouts, around which the spread is what the dynamics say.
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
    """Where the search stands: all that decides how it goes on.

    Attributes:
        controller: What makes the next rollouts.
        step: Bound on the KL divergence a control step, over the one asked for.
        states: Of remembered rollouts (N, T + 1, dx), the newest last.
        actions: Theirs (N, T, du).
        mixture: The prior of the dynamics.
        foretold: Expected cost before the last update, and what that update was to make of it; None: there was none.
    """

    controller: LinearGaussianController
    step: float = 1.0
    states: np.ndarray = field(default_factory=lambda: np.empty(0))
    actions: np.ndarray = field(default_factory=lambda: np.empty(0))
    mixture: Mixture | None = None
    foretold: tuple[float, float] | None = None


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
    """Learn from rollouts of `search.controller`.

    Args:
        search: Where the search stands.
        states: (N, T + 1, dx).
        actions: (N, T, du), before they are clipped: the dynamics know of the motors' limits.
        cost: What is minimised.
        kl: Bound on the KL divergence of an update, a control step, nats; adapted on the way.
        rng: Starts the mixture.
        least_std: Of the next controller's actions, whatever the update makes of it.
        period: Control steps from one frame to the next, of states with images.
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
    if search.foretold is not None:
        step = float(np.clip(step * step_change(*search.foretold, now), *STEP_RANGE))
    found = improve(dynamics, cost, search.controller, mean, covariance, kl * step * actions.shape[1], least_std)
    foretold = (now, found.marginals.cost(cost))
    return replace(
        search,
        controller=found.controller,
        step=step,
        states=remembered,
        actions=done,
        mixture=mixture,
        foretold=foretold,
    ), replace(found, seen=replace(before, state_mean=states.mean(axis=0), action_mean=actions.mean(axis=0)))


def step_change(before: float, foretold: float, actual: float) -> float:
    """What to multiply the step by, from the cost before an update, the cost foretold of it, and the actual one.

    Where the gain falls short of the foretold one by what the step's curvature costs, half of that quotient is the step
    that gains most (Levine et al. 2016, appendix A.2).
    """
    promised, gained = before - foretold, before - actual
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
    """Minimise the expected cost with KL(new || old) of a rollout at most `bound`, nats.

    The divergence falls as the dual variable rises; where even the least leaves it below the bound, that is the answer.

    Args:
        dynamics: The fitted dynamics.
        cost: What is minimised.
        old: The controller to stay near.
        mean: Of the initial state (dx,).
        covariance: Of the initial state (dx, dx).
        bound: On the divergence.
        least_std: Of the new controller's actions, in every direction; the divergence counts it.
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
    """The attempt whose divergence meets `bound` from below, within the tolerance."""
    low, high = np.log(LEAST_ETA), np.log(MOST_ETA)
    best: Improvement | None = None
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        try:
            found = attempt(float(np.exp(middle)))
        except (np.linalg.LinAlgError, ValueError):  # So small an eta that the Hessian is not positive in floats.
            low = middle
            continue
        if not found.divergence <= bound:  # NaN, too
            low = middle
            continue
        high, best = middle, found
        if found.divergence >= (1 - TOLERANCE) * bound:
            return found
    best = best or attempt(MOST_ETA)
    return replace(best, binding=False)
