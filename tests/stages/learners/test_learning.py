"""Learners learn, repeat under a seed, and resume bit for bit."""

import dataclasses

import numpy as np
import pytest

from artifacts import pack, unpack
from stages.config.stages import LearnerConfig
from stages.environments.simulated import SimulatedEnvironment
from stages.learners import loop
from stages.learners.algorithms import learner_state, make_learner, restore_learner
from stages.learners.loop import is_flat
from stages.rewards.state import OracleReward
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions
from stages.simulation.contexts import DISTRIBUTIONS, repeat
from stages.simulation.tasks.reach import Reach

SMALL = LearnerConfig(episodes=8, hidden=16)


def make(config, seed=0, **attributes):
    task = Reach()
    for name, value in attributes.items():
        setattr(task, name, value)
    context = task.draw_contexts(np.random.default_rng(3), 1, DISTRIBUTIONS["paper"])
    env = SimulatedEnvironment(
        task, config.episodes, seed, lambda rng, n: repeat(context, n), OracleReward(task), nthread=1
    )
    return make_learner(config, env, seed), env


def iterate(model, times):
    for _ in range(times):
        model.learn(model.env.num_envs * model.env.timing.control_steps, reset_num_timesteps=False)


def weights(model):
    return {name: value.numpy().copy() for name, value in model.policy.state_dict().items()}


def assert_same(one, other):
    for name, value in weights(one).items():
        np.testing.assert_array_equal(value, weights(other)[name], err_msg=name)


@pytest.mark.parametrize("attributes", [{}, {"truncates": True, "control_steps": 66}], ids=["ended", "cut-off"])
@pytest.mark.parametrize("learner", ["trpo", "ppo", "sac"])
def test_a_restored_learner_goes_on_bit_for_bit(learner, attributes):
    config = dataclasses.replace(SMALL, learner=learner)
    whole, _ = make(config, **attributes)
    iterate(whole, 4)
    begun, _ = make(config, **attributes)
    iterate(begun, 2)
    state = unpack(*pack(learner_state(begun)))
    resumed, _ = make(config, **attributes)
    restore_learner(resumed, state)
    iterate(resumed, 2)
    assert resumed.num_timesteps == whole.num_timesteps == 4 * SMALL.episodes * whole.env.timing.control_steps
    assert_same(whole, resumed)


def test_same_seed_same_policy_other_seed_another():
    models = []
    for seed in (1, 1, 2):  # Stable-Baselines3 seeds the global generators when a learner is made: one at a time.
        models.append(make(SMALL, seed)[0])
        iterate(models[-1], 2)
    assert_same(models[0], models[1])
    assert any(not np.array_equal(value, weights(models[2])[name]) for name, value in weights(models[0]).items())


def test_trpo_learns_to_reach_from_the_oracle_reward():
    model, env = make(LearnerConfig(episodes=60, hidden=32))
    iterate(model, 1)
    before = env.pop_distances().mean()
    iterate(model, 14)
    after = env.pop_distances()[-60:].mean()
    assert before > 0.6
    assert after < 0.35


def test_episodes_follow_from_seed_and_number():
    (_, first), (_, second) = make(SMALL, 4), make(SMALL, 4)
    begun = first.reset()
    assert np.array_equal(begun, second.reset())
    later = first.reset()
    assert not np.array_equal(begun, later)
    second.episode = 1
    assert np.array_equal(later, second.reset())


def test_flat_is_no_gain_over_as_many_iterations_before():
    rising, flat = [float(k) for k in range(20)], [0.0, 5.0, 9.0, *[10.0] * 8]
    assert not is_flat(rising, 4)
    assert is_flat(flat, 4)
    assert not is_flat(flat[:6], 4), "too few to tell"
    assert not is_flat(flat, 0), "never, by default"
    assert is_flat([0.0] * 8, 4), "a return that never changes is flat"
    assert is_flat([*rising, *[19.0 - k for k in range(8)]], 4), "falling is no gain either"


def test_learning_stops_once_the_return_is_flat(tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "FLAT", 1e9)  # Nothing counts as a gain.
    config = dataclasses.replace(SMALL, iterations=9, patience=2)
    _, env = make(config)
    run = RunOptions(progress=Progress(quiet=True))
    out = tmp_path / "a.policy.h5"
    _, curve = loop.learn(env, config, run, out, "learn-policy", Checkpoints(run, out, "learn-policy", {}, []))
    assert curve["iteration"] == [1.0, 2.0, 3.0, 4.0]
