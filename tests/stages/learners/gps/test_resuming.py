"""Guided policy search goes on from a checkpoint bit for bit, also around its refinement and its several starts."""

import dataclasses
import itertools

import numpy as np
import pytest

from artifacts import Interrupted, pack, unpack
from stages.config.stages import PolicyConfig
from stages.learners import loop
from stages.learners.algorithms import learner_state, make_learner, restore_learner
from stages.learners.gps.lqr import on_part
from stages.rewards.state import GoalReward
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions
from stages.simulation.tasks.reach import Reach
from tests.stages.learners.gps.samples import SMALL, context_of, environment


def resumes(make, total, done):
    """One learner of `make` goes on from another's state after `done` iterations, bit for bit; returns both."""
    whole, begun, resumed = (make() for _ in range(3))
    for model, times in ((whole, total), (begun, done)):
        for _ in range(times):
            model.learn(0)
    restore_learner(resumed, unpack(*pack(learner_state(begun))))
    for _ in range(total - done):
        resumed.learn(0)
    assert resumed.num_timesteps == whole.num_timesteps
    for one, other in ((whole.own, resumed.own), (whole.controller, resumed.controller)):
        for name, values in one.arrays().items():
            np.testing.assert_array_equal(values, other.arrays()[name], err_msg=name)
    return begun, resumed


def test_a_restored_learner_goes_on_bit_for_bit():
    _, resumed = resumes(lambda: make_learner(SMALL, environment(SMALL), 4), 4, 2)
    assert resumed.num_timesteps == 4 * 5 * 50


def test_the_own_controller_does_on_average_what_the_last_rollouts_did():
    """Not what the update behind them is predicted to do: nobody has tried that."""
    model = make_learner(SMALL, environment(SMALL), 4)
    done, rollouts = [], model.rollouts
    model.rollouts = lambda rng: done.append(rollouts(rng)) or done[-1]
    for _ in range(3):
        model.learn(0)
    states, actions = (values.mean(axis=0) for values in done[-1])
    size = model.own.gains.shape[2]
    for step in (0, 20, 49):
        np.testing.assert_allclose(model.own.act(step, states[step, :size]), actions[step], atol=1e-9)


class Coarse(GoalReward):
    """The distance to the goal, of which the last coordinate counts only once the target is refined."""

    def __init__(self, task, contexts):
        super().__init__(task, contexts)
        self.finer = GoalReward(task, contexts)
        self.targets = self.targets[:, :-1]

    def tracked(self, moment):
        return super().tracked(moment)[:, :-1]


def test_the_finer_target_is_tracked_after_a_third_of_the_iterations():
    task = Reach()
    reward = Coarse(task, context_of(task))
    config = dataclasses.replace(SMALL, iterations=6)
    env = environment(config, task, reward)
    model = make_learner(config, env, 4)
    for _ in range(2):
        model.learn(0)
    coarse = model.controller.gains.shape[2]
    own = on_part(model.controller, model.last.marginals, model.own.gains.shape[2])
    assert env.reward is reward
    seen = []
    rollouts = model.rollouts
    model.rollouts = lambda rng: seen.append(model.controller) or rollouts(rng)
    model.learn(0)
    assert env.reward is reward.finer
    assert model.controller.gains.shape[2] == coarse + 1
    np.testing.assert_array_equal(seen[0].gains[:, :, : own.gains.shape[2]], own.gains)
    assert not seen[0].gains[:, :, own.gains.shape[2] :].any(), "what it saw before is not what it sees now"
    np.testing.assert_array_equal(seen[0].offsets, own.offsets)


@pytest.mark.parametrize("done", [1, 2, 3])
def test_a_learner_restored_before_or_behind_the_refinement_goes_on_bit_for_bit(done):
    task, config = Reach(), dataclasses.replace(SMALL, iterations=6)
    resumes(lambda: make_learner(config, environment(config, task, Coarse(task, context_of(task))), 4), 4, done)


class TestStarts:
    """Searches that begin apart; of 12 iterations six, two each."""

    CONFIG = PolicyConfig(learner="gps", episodes=5, iterations=12, starts=3, kl=1.0, log_std=0.0)

    def test_each_has_two_turns_and_the_cheapest_goes_on(self):
        model = make_learner(self.CONFIG, environment(self.CONFIG), 5)
        ran, done, rollouts = [], [], model.rollouts
        model.rollouts = lambda rng: ran.append(model.controller) or done.append(rollouts(rng)) or done[-1]
        found, costs, owns = [], [], []
        for _ in range(6):
            model.learn(0)
            found.append(model.last)
            costs.append(model._cost.of(*done[-1]).mean())
            owns.append(on_part(ran[-1], model.last.seen, model.own.gains.shape[2]))
            latest = range(max(len(costs) - 3, 0), len(costs))
            cheapest = min(latest, key=costs.__getitem__)
            np.testing.assert_array_equal(model.own.gains, owns[cheapest].gains)
        assert len(set(costs[3:])) == 3
        for k in range(3):
            assert ran[k] is ran[0], "all begin with the same noise about zero"
            assert ran[k + 3] is found[k].controller
        assert cheapest != 5, "else what went on may be what ran last"
        assert model.controller is found[cheapest].controller
        for _ in range(2):
            model.learn(0)
            assert model.controller is model.last.controller

    @pytest.mark.parametrize("done", [2, 5, 6, 7])
    def test_restored_they_go_on_bit_for_bit(self, done):
        task = Reach()
        config = self.CONFIG
        begun, resumed = resumes(
            lambda: make_learner(config, environment(config, task, Coarse(task, context_of(task))), 4), 8, done
        )
        assert isinstance(begun.env.reward, Coarse) == (done <= 6), "the finer target waits for one search"
        assert not isinstance(resumed.env.reward, Coarse)


def test_an_interrupted_run_resumes_from_its_checkpoint_with_the_same_curve(tmp_path):
    def learn(env, name):
        out = tmp_path / f"{name}.policy.h5"
        run = RunOptions(progress=Progress(quiet=True), resume=True)
        model, curve = loop.learn(env, SMALL, run, out, "learn-policy", Checkpoints(run, out, "learn-policy", {}, []))
        return model.own.arrays(), {name: values for name, values in curve.items() if name != "seconds"}

    whole, curve = learn(environment(SMALL), "whole")
    env = environment(SMALL)
    step, taken = env.step_wait, itertools.count(1)

    def stopping():
        if next(taken) > 3 * env.timing.control_steps:
            raise KeyboardInterrupt
        return step()

    env.step_wait = stopping
    with pytest.raises(Interrupted, match="3 of 4 iterations"):
        learn(env, "parts")
    parts, resumed = learn(environment(SMALL), "parts")
    assert resumed == curve
    assert set(curve) == {"iteration", "samples", "return", "normalised_distance", "success", "action_std"}
    for name, values in whole.items():
        np.testing.assert_array_equal(values, parts[name])
