"""What one iteration of the search is made of: what it remembers, where it starts from, and how far it may go."""

import dataclasses

import numpy as np
import pytest

from stages.learners.gps import gps as module
from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.dynamics import transitions
from stages.learners.gps.gps import LEAST_VARIANCE, Improvement, Search, iterate, step_change
from stages.learners.gps.lqr import forward

KL = 0.5


@pytest.fixture
def search():
    return Search(LinearGaussianController.constant(12, 4, 2, 1.0))


@pytest.fixture
def rolled(mass, roll):
    """A function (search, seed, n) -> rollouts of its controller."""

    def run(search, seed, n=8):
        rng = np.random.default_rng(seed)
        return roll(mass, search.controller, 0.1 * rng.standard_normal((n, 4)), rng)

    return run


@pytest.fixture
def spied(monkeypatch):
    """Arguments that an iteration calls its parts with, by name."""
    seen = {}

    def spy(name):
        real = getattr(module, name)

        def call(*given, **named):
            seen.setdefault(name, []).append((given, real(*given, **named)))
            return seen[name][-1][1]

        monkeypatch.setattr(module, name, call)

    for name in ("fit_prior", "fit_dynamics", "forward", "improve"):
        spy(name)
    return seen


def test_the_newest_sixty_rollouts_are_remembered_and_grouped_by_iteration(search, rolled, to_place, spied):
    made = []
    for k in range(9):
        made.append(rolled(search, k))
        search, _ = iterate(search, *made[-1], to_place(12), KL, np.random.default_rng(k))
    states, actions = (np.concatenate([part[i] for part in made])[-60:] for i in range(2))
    np.testing.assert_array_equal(search.states, states)
    np.testing.assert_array_equal(search.actions, actions)
    fitted, _ = spied["fit_prior"][-1]
    np.testing.assert_array_equal(fitted[0], transitions(states, actions))
    given, _ = spied["fit_dynamics"][-1]
    np.testing.assert_array_equal(given[0], made[-1][0])
    earlier = given[4]
    assert [len(part) for part in earlier] == [8] * 7 + [4], "before the last iteration sixty were remembered"
    for age, part in enumerate(earlier[:7], 2):
        np.testing.assert_array_equal(part, transitions(*made[-age]))
    np.testing.assert_array_equal(earlier[7], transitions(*made[-9])[-4:])
    assert list(spied["fit_dynamics"][0][0][4]) == []


def test_the_prior_goes_on_from_the_last_ones_and_is_kept(search, rolled, to_place, spied):
    for k in range(2):
        search, _ = iterate(search, *rolled(search, k), to_place(12), KL, np.random.default_rng(k))
    (first, second) = spied["fit_prior"]
    assert first[0][2] is None and second[0][2] is first[1]
    assert search.mixture is second[1]
    assert spied["fit_dynamics"][1][0][2] is second[1]


def test_the_update_starts_where_the_rollouts_did_and_may_go_as_far_as_asked(search, rolled, to_place, spied):
    states, actions = rolled(search, 0)
    cost = to_place(12)
    after, found = iterate(search, states, actions, cost, KL, np.random.default_rng(0), 0.3)
    dynamics, of, old, mean, covariance, bound, least = spied["improve"][0][0]
    assert dynamics is spied["fit_dynamics"][0][1] and of is cost and old is search.controller and least == 0.3
    np.testing.assert_allclose(mean, states[:, 0].mean(axis=0))
    np.testing.assert_allclose(covariance, np.cov(states[:, 0].T, ddof=0) + LEAST_VARIANCE * np.eye(4))
    assert bound == found.bound == pytest.approx(KL * 12)
    before = forward(dynamics, search.controller, mean, covariance)
    assert after.predicted == pytest.approx((before.cost(cost), found.marginals.cost(cost)))
    assert after.controller is found.controller and after.step == 1.0
    np.testing.assert_array_equal(found.seen.state_mean, states.mean(axis=0))
    np.testing.assert_array_equal(found.seen.action_mean, actions.mean(axis=0))
    np.testing.assert_array_equal(found.seen.state_covariance, before.state_covariance)
    np.testing.assert_array_equal(found.seen.cross, before.cross)


@pytest.mark.parametrize(
    ("step", "predicted", "expected"), [(1.0, 0.5, 5.0), (4.0, 0.5, 10.0), (0.2, -1e9, 0.1), (0.06, -1e9, 0.05)]
)
def test_the_step_follows_the_last_updates_success_within_its_range(
    search, rolled, to_place, step, predicted, expected
):
    """A gain far beyond what was predicted lengthens the step fivefold; one far short of it halves it."""
    cost = to_place(12)
    states, actions = rolled(search, 0)
    now = iterate(search, states, actions, cost, KL, np.random.default_rng(0))[0].predicted[0]
    was = dataclasses.replace(search, step=step, predicted=(now + (1.0 if predicted > 0 else 0.0), now + predicted))
    after, found = iterate(was, states, actions, cost, KL, np.random.default_rng(0))
    assert after.step == pytest.approx(expected, rel=1e-3)
    assert found.bound == pytest.approx(KL * 12 * expected, rel=1e-3)


def test_a_step_changes_by_what_its_curvature_cost():
    assert step_change(10.0, 6.0, 7.0) == pytest.approx(2.0)
    assert step_change(10.0, 6.0, 12.0) == pytest.approx(4 / 12)
    assert step_change(10.0, 10.0, 10.0) == 0.1, "nothing was promised"
    assert step_change(0.0, 0.0, -1.0) == 0.1
    assert step_change(10.0, 11.0, 10.0) == 0.1


def attempts(divergence_of):
    """An update whose divergence is a function of the dual variable, and the dual variables that were tried."""
    tried = []

    def attempt(eta):
        tried.append(eta)
        value = divergence_of(eta)
        if value is None:
            raise np.linalg.LinAlgError
        return Improvement(None, None, value, 0.0, eta, binding=True)

    return attempt, tried


def test_bisection_meets_the_bound_from_below():
    attempt, tried = attempts(lambda eta: 1.0 / eta)
    found = module._bisect(attempt, 2.0)
    assert found.binding and 0.95 * 2.0 <= found.divergence <= 2.0
    assert tried[0] == pytest.approx(100.0), "in the middle of 1e-10 and 1e14"
    assert len(tried) < 15


def test_where_even_the_least_dual_variable_stays_below_the_bound_nothing_binds():
    attempt, tried = attempts(lambda eta: 1e-30 / eta)
    found = module._bisect(attempt, 2.0)
    assert not found.binding and found.eta < 2e-10 and len(tried) == 60


def test_dual_variables_too_small_to_compute_with_are_passed_over():
    attempt, _ = attempts(lambda eta: None if eta < 1e3 else float("nan") if eta < 1e6 else 1e7 / eta)
    found = module._bisect(attempt, 2.0)
    assert found.binding and 0.95 * 2.0 <= found.divergence <= 2.0


def test_where_nothing_meets_the_bound_the_largest_dual_variable_is_taken():
    attempt, tried = attempts(lambda eta: 5.0)
    found = module._bisect(attempt, 2.0)
    assert found.eta == tried[-1] == 1e14 and not found.binding
