"""Which distances an evaluation measures, and which of them decides what."""

from __future__ import annotations

import numpy as np
import pytest

from stages.config.stages import HOUSEHOLD, TASKS
from stages.evaluate import _padded
from stages.reporting.figures import figures
from stages.reporting.intervals import bootstrap_mean, wilson
from stages.reporting.judging import simulated_episodes
from stages.runtime.seeding import generator
from stages.simulation.batch import rollout
from stages.simulation.contexts import repeat
from stages.simulation.registry import distribution, learner_context, make_task

# Of three runs: all episodes of the deterministic policies, then of the stochastic ones.
DETERMINISTIC = np.array([[0.1, 0.9, 0.9], [0.9, 0.9, 0.9], [0.9, 0.9, 0.6]])
STOCHASTIC = np.array([[0.2, 0.2, 0.9], [0.7, 0.1, 0.8], [0.0, 0.0, 1.2]])
MEANS = [1.3 / 3, 1.6 / 3, 0.4]


def test_the_stochastic_policys_mean_distance_decides_the_success_of_a_run():
    found = figures(DETERMINISTIC, STOCHASTIC, 0.5)
    assert (found["runs"], found["resampled"], found["succeeded"]) == (3, "runs", 2)
    assert found["per_run_distance"] == pytest.approx(MEANS)
    assert found["success_paper"] == pytest.approx(2 / 3)
    assert found["success_paper_interval"] == wilson(2, 3)
    assert found["normalised_distance_stochastic"] == pytest.approx(np.mean(MEANS))
    assert found["normalised_distance_stochastic_interval"] == pytest.approx(bootstrap_mean(np.array(MEANS)))


def test_deterministic_episodes_have_figures_of_their_own():
    found = figures(DETERMINISTIC, STOCHASTIC, 0.5)
    assert found["normalised_distance"] == pytest.approx(7.0 / 9)
    assert found["normalised_distance_interval"] == pytest.approx(bootstrap_mean(DETERMINISTIC.mean(axis=1)))
    assert found["success_deterministic"] == pytest.approx(1 / 9)
    assert found["success_deterministic_interval"] == pytest.approx(bootstrap_mean(np.array([1 / 3, 0, 0])))


def test_of_one_run_the_episodes_are_resampled():
    found = figures(DETERMINISTIC[:1], STOCHASTIC[:1], 0.5)
    assert (found["runs"], found["resampled"]) == (1, "episodes")
    assert found["normalised_distance_interval"] == bootstrap_mean(DETERMINISTIC[0])
    assert found["normalised_distance_stochastic_interval"] == bootstrap_mean(STOCHASTIC[0])
    assert found["success_paper_interval"] == wilson(1, 1)


def test_a_distance_at_the_threshold_is_no_success():
    half = np.full((1, 4), 0.5)
    found = figures(half, half, 0.5)
    assert (found["succeeded"], found["success_paper"], found["success_deterministic"]) == (0, 0.0, 0.0)


@pytest.mark.parametrize("name", (*TASKS, *HOUSEHOLD))
def test_thresholds_are_the_papers(name):
    assert make_task(name).success_threshold == {"sweep": 0.55, "push-real": 0.25}.get(name, 0.5)


def test_curves_of_unequal_length_are_filled_with_nan():
    padded = _padded([np.array([1.0, 2.0, 3.0]), np.array([4.0])])
    np.testing.assert_array_equal(padded, [[1, 2, 3], [4, np.nan, np.nan]])


class Push:
    """A policy that pushes with constant action; with noise, the other way."""

    def __init__(self, size):
        self.size = size

    def act(self, observations, noise=None):
        return np.full((len(observations), self.size), 0.6 if noise is None else -0.4, np.float32)


def test_episodes_are_measured_without_and_with_noise_from_the_same_states():
    task = make_task("reach")
    contexts = learner_context(task, 0, distribution("paper"))
    found = simulated_episodes(task, Push(task.action_size), contexts, 3, 7, 2)
    same = repeat(contexts, 3)
    states = task.draw_states(generator(7, "evaluate", 2), same)
    for suffix, action in (("", 0.6), ("_stochastic", -0.4)):
        expected = rollout(task, same, *states, lambda state, _, a=action: np.full((3, task.action_size), a), 1)
        np.testing.assert_allclose(found[f"final_distance{suffix}"], expected.final_distance)
        np.testing.assert_allclose(found[f"normalised_distance{suffix}"], expected.normalised_distance)
        np.testing.assert_allclose(found["initial_distance"], expected.initial_distance)
    assert len(set(found["initial_distance"])) == 3
    assert not np.allclose(found["final_distance"], found["final_distance_stochastic"])
    other = simulated_episodes(task, Push(task.action_size), contexts, 3, 7, 3)
    assert not np.allclose(other["initial_distance"], found["initial_distance"]), "every policy has its own states"
