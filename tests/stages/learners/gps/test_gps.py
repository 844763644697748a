"""The search meets its bound, learns from few rollouts, resumes bit for bit, and refuses what it cannot do."""

import dataclasses

import numpy as np
import pytest

from artifacts import ArtifactError, UsageError, read_artifact, write_artifact
from stages.config.presets import defaults
from stages.config.stages import PolicyConfig
from stages.environments.simulated import SimulatedEnvironment
from stages.learners.algorithms import make_learner
from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.gps import STEP_CHANGE, Search, improve, iterate, step_change
from stages.learners.gps.learner import EXPLORATION
from stages.learners.gps.lqr import backward, divergence, forward
from stages.learners.policy import Policy, policy_weights
from stages.rewards.state import GoalReward, OracleReward
from stages.runtime.run import RunOptions
from stages.simulation.batch import rollout
from stages.simulation.contexts import DISTRIBUTIONS, repeat
from stages.simulation.registry import learner_context, make_task
from stages.simulation.tasks.reach import Reach
from tests.stages.learners.gps.samples import CONFIG, SMALL, context_of, environment


def test_the_bound_is_met_and_the_cost_falls_at_every_step_of_a_run(mass, to_place, roll):
    cost, kl = to_place(12), 0.5
    search = Search(LinearGaussianController.constant(12, 4, 2, 1.0))
    costs, bounds = [], []
    for k in range(8):
        rng = np.random.default_rng(k)
        states, actions = roll(mass, search.controller, 0.05 * rng.standard_normal((20, 4)), rng)
        costs.append(cost.of(states, actions).mean())
        search, found = iterate(search, states, actions, cost, kl, rng)
        assert found.bound == pytest.approx(kl * search.step * 12)
        assert found.divergence <= found.bound
        if found.binding:
            assert found.divergence >= 0.95 * found.bound
        bounds.append(found.binding)
        assert search.predicted[1] < search.predicted[0]
    assert bounds[0], "the first step is bounded"
    best = forward(mass, backward(mass, cost, 1e-6), np.zeros(4), 0.0025 * np.eye(4)).cost(cost)
    assert costs[0] > 1.5 * best
    assert costs[-1] < 1.05 * best


def test_a_bound_that_does_not_bind_leaves_the_optimum(mass, to_place):
    cost, old = to_place(12), LinearGaussianController.constant(12, 4, 2, 1.0)
    found = improve(mass, cost, old, np.zeros(4), 0.01 * np.eye(4), 1e9)
    assert not found.binding
    np.testing.assert_allclose(found.controller.gains, backward(mass, cost, 1e-6).gains, atol=1e-5)


def test_the_bound_is_met_by_the_controller_that_is_run(mass, to_place):
    """Its noise is no less than asked for, and what the update saves by not losing noise it spends on the actions."""
    cost, old = to_place(12), LinearGaussianController.constant(12, 4, 2, 0.5)
    start = np.zeros(4), 0.01 * np.eye(4)
    narrow, wide = (improve(mass, cost, old, *start, 40.0, least) for least in (0.0, 0.5))
    assert np.linalg.eigvalsh(wide.controller.covariances).min() >= 0.999 * 0.25
    for found in (narrow, wide):
        assert found.binding and 0.95 * 40 <= found.divergence <= 40
        assert divergence(found.controller, old, found.marginals) == pytest.approx(found.divergence)
    moved = [np.square(found.marginals.action_mean).sum() for found in (narrow, wide)]
    assert moved[1] > 1.02 * moved[0]


@pytest.mark.parametrize(
    ("before", "predicted", "actual", "change"),
    [(10, 6, 6, 5.0), (10, 6, 8, 1.0), (10, 6, 10, 0.5), (10, 6, 90, 0.1), (10, 6, 1, 5.0)],
)
def test_the_step_follows_from_what_came_of_the_last(before, predicted, actual, change):
    expected = change if change != 0.1 else max(STEP_CHANGE[0], 4 / (2 * 84))
    assert step_change(before, predicted, actual) == pytest.approx(expected)


@pytest.mark.parametrize("log_std", [0.0, -2.0])
def test_noise_is_kept_until_the_last_iteration(log_std):
    config = dataclasses.replace(SMALL, log_std=log_std)
    model = make_learner(config, environment(config), 4)
    for done in range(1, config.iterations + 1):
        model.learn(0)
        least = np.exp(min(EXPLORATION, log_std)) * (1 - done / config.iterations)
        assert np.linalg.eigvalsh(model.controller.covariances).min() >= 0.999 * least**2


def test_a_wider_controller_keeps_the_noise_that_it_has(any_controller):
    narrow = any_controller(0)
    variances = np.linalg.eigvalsh(narrow.covariances)
    least = float(np.sqrt(np.median(variances)))
    wide = narrow.widened(least)
    np.testing.assert_allclose(np.linalg.eigvalsh(wide.covariances), np.maximum(variances, least**2))
    np.testing.assert_array_equal(wide.gains, narrow.gains)


def test_actions_cost_the_more_the_larger_the_reward():
    task = Reach()
    costs = []
    for scale in (1.0, 10.0):
        reward = GoalReward(task, context_of(task))
        reward.cost_weights = scale * reward.cost_weights
        costs.append(make_learner(SMALL, environment(SMALL, task, reward), 0)._cost)
    np.testing.assert_allclose(costs[1].action, 10 * costs[0].action)


@pytest.mark.slow
def test_a_can_is_pushed_within_the_limits_of_the_motors():
    """With actions a tenth as dear, they grew to a hundred times the limit here, and the can ended anywhere."""
    task = make_task("push-real")
    config = defaults("quick", "learn-policy", "push-real", "gps")
    config = dataclasses.replace(config, learner="gps", iterations=12)
    context = learner_context(task, 0, DISTRIBUTIONS["paper"])
    env = SimulatedEnvironment(task, 10, 0, lambda rng, n: repeat(context, n), GoalReward(task, context), nthread=1)
    model = make_learner(config, env, 0)
    for _ in range(config.iterations):
        model.learn(0)
        distances = env.pop_distances()
    assert distances.mean() < task.success_threshold
    assert np.abs(model.last.marginals.action_mean).max() < 2


def test_reach_is_learned_from_100_rollouts_and_the_policy_needs_no_goal(tmp_path):
    env = environment()
    model = make_learner(CONFIG, env, 0)
    left = []
    for _ in range(10):
        model.learn(0)
        left.append(env.pop_distances().mean())
    assert left[0] > 0.6
    assert left[-1] < 0.1
    assert model.num_timesteps == 100 * 50
    path = write_artifact(
        tmp_path / "a.policy.h5",
        "policy",
        policy_weights(model),
        config={"learner": "gps", "observation_size": env.observation_size, "action_size": 3},
        seed=0,
        command="ifo",
    )
    policy, task = Policy.load(read_artifact(path, "policy")), env.task
    contexts = repeat(context_of(task), 20)
    start = task.draw_states(np.random.default_rng(9), contexts)
    ended = rollout(task, contexts, *start, lambda state, _: policy.act(task.observe(state)), 1)
    assert ended.normalised_distance.mean() < 0.1


def test_a_policy_file_of_the_wrong_sizes_is_refused(tmp_path):
    config = {"learner": "gps", "observation_size": 7, "action_size": 3}
    arrays = LinearGaussianController.constant(50, 5, 3, 1.0).arrays()
    cases = [(arrays, "expected"), ({"gains": arrays["gains"]}, "valid controller")]
    cases.append(({**arrays, "covariances": -arrays["covariances"]}, "valid controller"))
    cases.append(({**arrays, "covariances": arrays["covariances"] + np.triu(np.ones((3, 3)), 1)}, "symmetric"))
    cases.append(({name: values[:0] for name, values in arrays.items()}, "no control step"))
    for k, (broken, message) in enumerate(cases):
        weights = {f"weights/{name}": values for name, values in broken.items()}
        path = write_artifact(tmp_path / f"{k}.policy.h5", "policy", weights, config=config, seed=0, command="ifo")
        with pytest.raises(ArtifactError, match=message):
            Policy.load(read_artifact(path, "policy"))


def test_noise_is_drawn_from_the_generator_alone():
    import torch

    from stages.learners.policy import ControllerPolicy

    policy = ControllerPolicy(LinearGaussianController.constant(50, 6, 3, 0.3))
    seen = np.zeros((4, 7), np.float32)
    assert not policy.act(seen).any()
    same = [policy.act(seen, torch.Generator().manual_seed(1)) for _ in range(2)]
    np.testing.assert_array_equal(*same)
    assert same[0].any() and np.abs(same[0]).max() <= 1


@pytest.mark.parametrize("name", ["reach", "push", "sweep", "strike", "push-real"])
def test_errors_of_tasks_have_the_distance_as_norm(name):
    """Their first part, that is, at the start; in sweep ball by ball."""
    task = make_task(name)
    contexts = repeat(context_of(task), 4)
    env = SimulatedEnvironment(task, 4, 0, lambda rng, n: contexts, OracleReward(task), nthread=1)
    env.reset()
    error, distance = task.goal_error(env.moment.state, contexts), task.distance(env.moment.state, contexts)
    if name == "sweep":
        np.testing.assert_allclose(np.linalg.norm(error.reshape(4, 5, 2), axis=2).mean(axis=1), distance)
    else:
        np.testing.assert_allclose(np.linalg.norm(error[:, :2], axis=1), distance)


def test_refusals_are_one_line():
    class Timeless(Reach):
        def observe(self, state):
            return super().observe(state)[:, :-1]

    class Long(Reach):
        control_steps = 1000

    cases = [
        (lambda: environment(task=Long()), CONFIG, "at most 200"),
        (lambda: environment(reward=OracleReward(Reach())), CONFIG, "expected --reward translation"),
        (lambda: environment(task=Timeless()), CONFIG, "clock"),
        (environment, dataclasses.replace(CONFIG, kl=0.0), "--kl 0"),
    ]
    for make, config, message in cases:
        with pytest.raises(UsageError, match=message) as caught:
            make_learner(config, make(), 0)
        assert "\n" not in str(caught.value)
    task = make_task("dm:reacher-easy", typed=True)
    with pytest.raises(UsageError, match="goal_error"):
        GoalReward(task, context_of(task))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reward": "gail"}, "expected --reward translation, video, oracle, joints"),
        ({"reward": "tpil"}, "expected --reward translation, video, oracle, joints"),
        ({"negatives": 5}, "--negatives"),
        (
            {"fine_blur": 3.0, "learner": "trpo"},
            "--fine-blur 3 has no effect with --learner trpo: expected --learner",
        ),
        ({"fine_blur": 3.0, "patience": 5}, "--patience would stop"),
        ({"layer": "block2"}, "--layer block2 has no effect with --reward translation: expected --reward pretrained"),
        (
            {"weights": "none.pth", "reward": "oracle"},
            "--weights none.pth has no effect with --reward oracle: expected --reward pretrained",
        ),
        ({"starts": 2, "learner": "trpo"}, "--starts 2 has no effect with --learner trpo: expected --learner gps"),
        ({"starts": 2, "iterations": 3}, "--starts 2 --iterations 3: expected at least 4 iterations"),
        ({"starts": 2, "patience": 5}, "--patience would stop"),
    ],
)
def test_rewards_that_do_not_fit_are_refused_before_anything_is_read(tmp_path, options, message):
    from stages.learn_policy import learn_policy

    with pytest.raises(UsageError, match=message):
        learn_policy(PolicyConfig(**{"learner": "gps", **options}), RunOptions(), tmp_path / "none.translation.h5")


def test_a_learner_has_its_own_defaults():
    assert defaults("quick", "learn-policy", "reach").episodes == 100
    gps = defaults("quick", "learn-policy", "strike", "gps")
    assert (gps.iterations, gps.episodes, gps.image_weight) == (20, 10, 8.0)
    assert defaults("toy", "learn-policy", "reach", "gps").episodes == 5
    household = defaults("quick", "learn-policy", "sweep-paper", "gps")
    assert (household.ramp, household.blur, household.fine_blur) == ("none", 8.0, 3.0)
    assert (household.iterations, household.episodes) == (50, 10)
    assert defaults("toy", "learn-policy", "sweep-paper", "gps").episodes == 5
    assert gps.fine_blur == defaults("quick", "learn-policy", "push-real", "gps").fine_blur == 0
    assert defaults("quick", "learn-policy", "sweep-paper").ramp == "task", "TRPO has the usual ones"
    assert defaults("paper", "learn-policy", "sweep-paper", "gps").blur == 0, "as the paper has it"
