"""The batch of simulations as learners see it: episodes that end together, and what is told of how they ended."""

import numpy as np
import pytest

from stages.environments.simulated import SimulatedEnvironment
from stages.simulation.batch import BatchSimulation
from stages.simulation.contexts import DISTRIBUTIONS, repeat
from stages.simulation.tasks.reach import Reach

N = 3


class Recorded:
    """A reward that remembers what it was asked."""

    def __init__(self):
        self.steps, self.states, self.actions, self.closed = [], [], [], False

    def __call__(self, moment, action):
        self.steps.append(moment.step)
        self.states.append(moment.state)
        assert moment.observation.shape[0] == N
        self.actions.append(action)
        return np.arange(N) - 0.1 * moment.step

    def close(self):
        self.closed = True


@pytest.fixture
def make():
    """A function (attributes of the task) -> environment of three short episodes."""

    def environment(seed=0, expert=False, **attributes):
        task = Reach()
        for name, value in {"control_steps": 4, **attributes}.items():
            setattr(task, name, value)
        context = task.draw_contexts(np.random.default_rng(3), 1, DISTRIBUTIONS["paper"])
        return SimulatedEnvironment(task, N, seed, lambda rng, n: repeat(context, n), Recorded(), expert, nthread=1)

    return environment


def actions(step):
    return np.random.default_rng(step).uniform(-1, 1, (N, 3))


def play(env, steps=4):
    """Observations, rewards, ends and infos of so many steps."""
    return [env.step(actions(step)) for step in range(steps)]


@pytest.mark.parametrize("truncates", [False, True])
def test_the_end_of_an_episode_says_whether_it_was_merely_cut_off(make, truncates):
    """Stable-Baselines3 goes on with the value of what was cut off, and takes what ended for worth nothing."""
    env = make(truncates=truncates)
    env.reset()
    *before, (_, _, done, infos) = play(env)
    assert all(not each[2].any() and each[3] == [{}] * N for each in before)
    assert done.all() and done.shape == (N,)
    assert [info["TimeLimit.truncated"] for info in infos] == [truncates] * N


def test_a_learner_values_what_lies_beyond_an_episode_that_was_cut_off(make):
    from stages.config.stages import LearnerConfig
    from stages.learners.algorithms import make_learner

    last = []
    for truncates in (False, True):
        model = make_learner(LearnerConfig(episodes=N, hidden=8), make(truncates=truncates), 0)
        model.learn(4 * N)
        last.append(model.rollout_buffer.rewards)
    np.testing.assert_array_equal(last[0][:-1], last[1][:-1])
    assert (last[0][-1] != last[1][-1]).all()


def test_an_episode_that_ended_hands_over_its_last_observation_and_starts_the_next(make):
    env = make()
    first = env.reset()
    assert env.episode == 1
    observed, _, _, infos = play(env)[-1]
    assert env.episode == 2
    np.testing.assert_array_equal([info["terminal_observation"] for info in infos], env.task.observe(env.last.state))
    np.testing.assert_array_equal(observed, env.task.observe(env.moment.state))
    assert env.moment.state.time.max() == 0 and env.last.state.time.min() > 0
    assert not np.array_equal(observed, first), "another episode starts in another state"
    again = make()
    again.episode = 1
    np.testing.assert_array_equal(again.reset(), observed)
    again.episode = 0
    np.testing.assert_array_equal(again.reset(), first)


def test_what_the_learner_is_paid_is_what_the_reward_says_of_every_step(make):
    env = make()
    env.reset()
    for _ in range(2):
        seen = play(env)
        np.testing.assert_allclose(
            [rewards for _, rewards, _, _ in seen], np.arange(N) - 0.1 * np.arange(1, 5)[:, None]
        )
        assert seen[0][1].dtype == np.float32
    assert env.reward.steps == [1, 2, 3, 4] * 2
    np.testing.assert_array_equal(env.reward.actions[2], actions(2))
    np.testing.assert_array_equal(env.reward.states[3].qpos[:, :3], play_alone(env))


def play_alone(env):
    """Joint positions where the first episode ends."""
    again = SimulatedEnvironment(env.task, N, 0, env._draw_contexts, Recorded(), nthread=1)
    again.reset()
    simulation = BatchSimulation(env.task, N, 1)
    simulation.reset(again.moment.state.qpos, again.moment.state.qvel)
    for step in range(4):
        state = simulation.step(actions(step))
    return state.qpos[:, :3]


def test_distances_are_the_outcomes_of_the_episodes_that_ended_since_they_were_asked_for(make):
    env = make()
    assert env.pop_distances().shape == (0,)
    env.reset()
    expected = []
    for _ in range(2):
        start = env.task.distance(env.moment.state, env.moment.contexts)
        play(env)
        expected.append(env.task.distance(env.last.state, env.moment.contexts) / start)
    np.testing.assert_allclose(env.pop_distances(), np.concatenate(expected))
    assert env.pop_distances().shape == (0,)
    play(env, 3)
    assert env.pop_distances().shape == (0,), "the third has not ended"


def test_the_outcome_is_what_the_task_makes_of_all_distances(make):
    class Nearest(Reach):
        control_steps = 4

        def outcome(self, distance):
            assert distance.shape == (N, 5)
            return np.full(N, 2.0), distance.min(axis=1)

    task = Nearest()
    context = task.draw_contexts(np.random.default_rng(3), 1, DISTRIBUTIONS["paper"])
    env = SimulatedEnvironment(task, N, 0, lambda rng, n: repeat(context, n), Recorded(), nthread=1)
    env.reset()
    least = task.distance(env.moment.state, env.moment.contexts)
    for step in range(4):
        env.step(actions(step))
        least = np.minimum(least, task.distance((env.last if step == 3 else env.moment).state, env.moment.contexts))
    np.testing.assert_allclose(env.pop_distances(), least / 2)


def test_an_expert_sees_more_than_a_learner(make):
    learner, expert = make(), make(expert=True)
    assert expert.observation_size > learner.observation_size
    assert expert.observation_space.shape == (expert.observation_size,)
    np.testing.assert_array_equal(
        expert.reset(), expert.task.observe_expert(expert.moment.state, expert.moment.contexts)
    )
    assert learner.action_space.shape == (3,) and learner.num_envs == N
    assert (learner.action_space.low == -1).all() and (learner.action_space.high == 1).all()


def test_closing_closes_the_reward(make):
    env = make()
    env.close()
    assert env.reward.closed
