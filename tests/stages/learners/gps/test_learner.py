"""The learner around the search, on a point mass without a simulator: costs, noise, turns, refinement, state."""

import dataclasses
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from artifacts import UsageError, pack, unpack
from stages.config.stages import LearnerConfig, PolicyConfig
from stages.environments.protocol import Environment
from stages.environments.simulated import SimulatedMoment, ends_with_clock
from stages.environments.timing import Timing
from stages.learners.gps import learner as module
from stages.learners.gps.learner import GuidedPolicySearch
from stages.learners.gps.lqr import QuadraticCost, on_part
from stages.runtime.seeding import generator
from stages.simulation.task import State

STEPS, N = 6, 5
CONFIG = PolicyConfig(learner="gps", episodes=N, iterations=6, kl=1.0, log_std=0.0)


class Mass:
    """A task: two places and their speeds; the observation ends with the clock."""

    name, control_steps, action_size, horizon = "mass", STEPS, 2, 0.6

    def observe(self, state):
        return np.concatenate([state.qpos, state.qvel, state.time[:, None] / self.horizon], axis=1)


def state(qpos, qvel, time):
    return State(qpos=qpos, qvel=qvel, site_xpos=np.zeros((len(qpos), 1, 3)), time=np.full(len(qpos), time), ctrl=qpos)


class Place:
    """A reward that tracks one of the places, or both."""

    def __init__(self, entries=1, finer=None, period=None):
        self.targets = np.tile([[1.0, -1.0]], (STEPS + 1, 1))[:, :entries]
        self.cost_weights = np.linspace(0.5, 2.0, STEPS + 1)
        self.finer, self.frame_period, self.asked = finer, period, []

    def tracked(self, moment):
        self.asked.append(moment.step)
        return moment.state.qpos[:, : self.targets.shape[1]]

    def __call__(self, moment, action):
        return np.zeros(N)

    def unasked(self, *given):
        raise AssertionError("nobody asks for it")

    terms = iterate = state = restore = close = unasked


class MassEnv(Environment):
    """Five masses pushed about; every episode begins elsewhere."""

    def __init__(self, reward, task=None):
        self.task, self.acted = task or Mass(), []
        timing = Timing.regular(self.task.control_steps, 1)
        super().__init__(self.task.name, N, timing, reward, self.task.action_size)

    @property
    def has_clock(self):
        return ends_with_clock(self.task, self.moment.state)

    def begin(self):
        rng = np.random.default_rng(self.episode)
        return self.after(0, state(0.1 * rng.normal(size=(N, 2)), np.zeros((N, 2)), 0.0))

    def advance(self, actions):
        self.acted.append(actions)
        before = self.moment.state
        qvel = before.qvel + 0.3 * np.clip(actions, -1, 1)
        return self.after(self.moment.step + 1, state(before.qpos + 0.3 * qvel, qvel, before.time[0] + 0.1))

    def after(self, step, state):
        return SimulatedMoment(step, state, {}, self.task.observe(state))

    def record(self):
        pass

    def pop_figures(self):
        return {}


def make(config=CONFIG, reward=None, seed=4, **attributes):
    return GuidedPolicySearch(config, MassEnv(reward or Place(), **attributes), seed)


def standing_still(reward, env):
    """What it costs per step to stay where the environment is."""
    seen = env.moment.state.qpos[:, : reward.targets.shape[1]].mean(axis=0)
    return np.mean(
        [0.5 * w * np.square(goal - seen).sum() for w, goal in zip(reward.cost_weights, reward.targets, strict=True)]
    )


@pytest.mark.parametrize("entries", [1, 2])
def test_it_starts_from_noise_about_zero_and_a_cost_in_units_of_standing_still(entries):
    reward = Place(entries)
    model = make(dataclasses.replace(CONFIG, log_std=-0.5), reward)
    assert model.controller.gains.shape == (STEPS, 2, 4 + entries) and not model.controller.gains.any()
    assert model.own.gains.shape == (STEPS, 2, 4)
    for each in (model.controller, model.own):
        np.testing.assert_allclose(each.covariances, np.tile(np.exp(-1.0) * np.eye(2), (STEPS, 1, 1)))
    assert model.last is None and model.num_timesteps == 0
    penalty = 0.2 * standing_still(reward, model.env) * np.eye(2)
    expected = QuadraticCost.tracking(4 + entries, reward.targets, reward.cost_weights, penalty)
    for name in ("hessian", "gradient", "constant", "action"):
        np.testing.assert_allclose(getattr(model._cost, name), getattr(expected, name), err_msg=name)


def test_a_target_that_is_reached_from_the_start_leaves_actions_a_little_price():
    reward = Place()
    reward.cost_weights = np.zeros(STEPS + 1)
    np.testing.assert_allclose(make(reward=reward)._penalty, 0.2e-9 * np.eye(2))


def test_rollouts_are_observations_without_the_clock_beside_what_is_tracked():
    model = make()
    model.env.reward.asked.clear()
    states, actions = model.rollouts(np.random.default_rng(1))
    assert states.shape == (N, STEPS + 1, 5) and actions.shape == (N, STEPS, 2)
    assert model.env.reward.asked == list(range(STEPS + 1))
    rng = np.random.default_rng(1)
    for step in range(STEPS):
        np.testing.assert_array_equal(actions[:, step], rng.standard_normal((N, 2)), "the controller is noise yet")
        np.testing.assert_array_equal(model.env.acted[step], actions[:, step])
    start = 0.1 * np.random.default_rng(0).normal(size=(N, 2))
    np.testing.assert_allclose(states[:, 0], np.concatenate([start, np.zeros((N, 2)), start[:, :1]], axis=1))
    np.testing.assert_array_equal(states[:, -1, :2], model.env.last.state.qpos)
    np.testing.assert_array_equal(states[:, -1, 4], model.env.last.state.qpos[:, 0])
    again, _ = model.rollouts(np.random.default_rng(1))
    np.testing.assert_array_equal(
        again[:, 0, :2], 0.1 * np.random.default_rng(1).normal(size=(N, 2)), "the next episode"
    )


@pytest.fixture
def asked(monkeypatch):
    """What the iterations are called with."""
    calls, real = [], module.iterate

    def iterate(*given):
        calls.append((given, given[5].bit_generator.state["state"]))
        return real(*given)

    monkeypatch.setattr(module, "iterate", iterate)
    return calls


@pytest.mark.parametrize(("log_std", "least"), [(0.0, np.exp(-1.2)), (-1.2, np.exp(-1.2)), (-2.0, np.exp(-2.0))])
def test_an_iteration_is_given_the_rollouts_and_less_noise_each_time(asked, log_std, least):
    model = make(dataclasses.replace(CONFIG, log_std=log_std, kl=0.7), Place(period=2))
    for k in range(CONFIG.iterations):
        before = model.controller
        assert model.learn(0) is model
        (search, states, actions, cost, kl, _, least_std, period), _ = asked[k]
        assert search.controller is before and cost is model._cost
        assert states.shape == (N, STEPS + 1, 5) and actions.shape == (N, STEPS, 2)
        assert (kl, period) == (0.7, 2)
        assert least_std == pytest.approx(least * (1 - (k + 1) / 6))
        assert model.num_timesteps == (k + 1) * N * STEPS
        assert model.last.bound > 0 and model.controller is model.last.controller
    rng = generator(4, "gps", 0)
    np.testing.assert_allclose(asked[0][0][2][:, 0], np.exp(log_std) * rng.standard_normal((N, 2)))


def test_what_is_kept_are_the_controllers_on_the_robots_own_observation():
    model = make()
    for _ in range(2):
        ran = model.controller
        model.learn(0)
    start = model._starts[0]
    for found, expected in (
        (start.own, on_part(ran, model.last.seen, 4)),
        (start.next, on_part(model.controller, model.last.marginals, 4)),
    ):
        for name, values in expected.arrays().items():
            np.testing.assert_array_equal(found.arrays()[name], values)
    assert model.own is start.own


@pytest.mark.parametrize(("iterations", "starts", "turns"), [(12, 3, 6), (10, 2, 4), (4, 1, 0), (11, 2, 4), (6, 3, 3)])
def test_searches_take_turns_for_half_of_the_iterations_at_most(iterations, starts, turns):
    config = dataclasses.replace(CONFIG, iterations=iterations, starts=starts)
    model = make(config)
    alive = []
    for _ in range(iterations):
        model.learn(0)
        alive.append(len(model._starts))
    assert alive == [starts if k < turns else 1 for k in range(1, iterations + 1)]


def test_an_expert_has_one_search():
    assert len(make(LearnerConfig(learner="gps", episodes=N, iterations=6))._starts) == 1


@pytest.mark.parametrize(("iterations", "starts", "when"), [(6, 1, 2), (2, 1, 1), (12, 2, 6), (13, 1, 4)])
def test_the_finer_target_is_tracked_once_a_third_is_done_and_one_search_is_left(iterations, starts, when):
    fine = Place(2)
    config = dataclasses.replace(CONFIG, iterations=iterations, starts=starts)
    model = make(config, Place(1, finer=fine))
    for k in range(when):
        assert model.env.reward is not fine, k
        model.learn(0)
    following = model._starts[0].next
    model.learn(0)
    assert model.env.reward is fine and model._cost.hessian.shape[1] == 6
    ran = model._starts[0]
    least = np.exp(-1.2) * (1 - when / iterations)
    expected = following.lifted(6).widened(least)
    assert ran.search.states.shape == (N, STEPS + 1, 6), "older rollouts track other numbers and are gone"
    assert not expected.gains[:, :, 4:].any()
    if iterations > when + 1:
        model.learn(0)
        assert model.env.reward is fine


def test_the_first_rollouts_of_the_finer_target_are_of_the_next_controller_widened(asked):
    fine = Place(2)
    model = make(CONFIG, Place(1, finer=fine))
    for _ in range(2):
        model.learn(0)
    expected = model._starts[0].next.lifted(6).widened(np.exp(-1.2) * (1 - 2 / 6))
    model.learn(0)
    search = asked[-1][0][0]
    for name, values in expected.arrays().items():
        np.testing.assert_allclose(search.controller.arrays()[name], values, atol=1e-12)
    assert search.mixture is None and search.predicted is None and not len(search.states)
    reached = model._cost.action
    assert reached[0, 0] == pytest.approx(model._penalty[0, 0]), "actions cost what they did"


def test_costs_that_are_no_numbers_are_told():
    reward = Place()
    model = make(reward=reward)
    model._cost = dataclasses.replace(model._cost, constant=np.full(STEPS + 1, np.inf))
    with pytest.raises(FloatingPointError, match="rollouts is not finite"):
        model.learn(0)


def fresh(starts):
    return make(dataclasses.replace(CONFIG, starts=starts), Place(1, finer=Place(2)))


@cache
def states_of(starts):
    """Of an undisturbed learner: it, and its state before each of four iterations as a checkpoint holds it."""
    model, states = fresh(starts), []
    for _ in range(4):
        states.append(pack(model.state()))
        model.learn(0)
    return model, states


@pytest.mark.parametrize("done", [0, 1, 2, 3])
@pytest.mark.parametrize("starts", [1, 2])
def test_a_restored_learner_goes_on_bit_for_bit(done, starts):
    whole, states = states_of(starts)
    tree, resumed = unpack(*states[done]), fresh(starts)
    assert (tree["iterations"], tree["samples"]) == (done, done * N * STEPS)
    assert len(tree["starts"]) == (starts if done < 2 else 1)
    resumed.restore(tree)
    for _ in range(4 - done):
        resumed.learn(0)
    assert resumed.num_timesteps == whole.num_timesteps and resumed.env.episode == whole.env.episode
    for one, other in ((whole.own, resumed.own), (whole.controller, resumed.controller)):
        for name, values in one.arrays().items():
            np.testing.assert_array_equal(values, other.arrays()[name])
    np.testing.assert_array_equal(whole.env.moment.state.qpos, resumed.env.moment.state.qpos)


def test_refusals_name_the_task_and_what_to_do():
    class Long(Mass):
        control_steps = 201

    class Timeless(Mass):
        def observe(self, state):
            return super().observe(state)[:, [4, 0, 1, 2, 3]]

    class Untracked:
        def __call__(self, *given):
            pass

    cases = [
        (lambda: make(reward=Untracked()), "expected --reward .* \\(rewards with a target"),
        (lambda: make(dataclasses.replace(CONFIG, kl=0.0)), "--kl 0 .*--learner gps .*: expected more than 0"),
        (lambda: make(task=Long()), "at most 200 .*mass has 201; use --learner trpo"),
        (lambda: make(task=Timeless()), "observation of mass does not end with a clock; use --learner trpo"),
    ]
    for build, message in cases:
        with pytest.raises(UsageError, match=message) as caught:
            build()
        assert "\n" not in str(caught.value)

    class Longest(Mass):
        control_steps = 200

    reward = Place()
    reward.targets, reward.cost_weights = np.zeros((201, 1)), np.ones(201)
    make(reward=reward, task=Longest())


@pytest.mark.parametrize(
    ("observe", "ends"),
    [
        (lambda s: np.stack([s.qpos[:, 0], s.time / 0.6], axis=1), True),
        (lambda s: np.stack([s.time / 0.6, s.qpos[:, 0]], axis=1), False),
        (lambda s: np.stack([s.time, s.time / 0.6], axis=1), False),
        (lambda s: np.stack([s.qpos[:, 0], s.time], axis=1), False),
        (lambda s: np.stack([s.qpos[:, 0], 1 - s.time / 0.6], axis=1), False),
        (lambda s: np.stack([s.qpos[:, 0], s.time / 0.6 + 3], axis=1), True),
    ],
)
def test_a_clock_runs_from_start_to_end_of_an_episode_and_tells_the_time_nowhere_else(observe, ends):
    task = SimpleNamespace(horizon=0.6, observe=observe)
    assert ends_with_clock(task, state(np.ones((2, 2)), np.ones((2, 2)), 0.3)) is ends


def test_a_checkpoint_of_schema_1_names_the_predicted_cost_differently():
    tree, resumed = unpack(*states_of(1)[1][1]), fresh(1)
    expected = tuple(tree["starts"][0].pop("predicted"))
    tree["starts"][0]["foretold"] = expected
    resumed.restore(tree)
    assert resumed._starts[0].search.predicted == expected and len(expected) == 2
