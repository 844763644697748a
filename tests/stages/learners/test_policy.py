"""A policy without its learner: what it does, and what its file must hold."""

import dataclasses

import numpy as np
import pytest
import torch

from artifacts import ArtifactError, read_artifact, write_artifact
from stages.config.stages import LearnerConfig
from stages.environments.simulated import SimulatedEnvironment
from stages.learners.algorithms import make_learner
from stages.learners.gps.lqr import on_part
from stages.learners.policy import Policy, check_fits, first_observation, policy_weights
from stages.rewards.state import GoalReward
from stages.simulation.contexts import DISTRIBUTIONS, repeat
from stages.simulation.tasks.reach import Reach

SMALL = LearnerConfig(episodes=4, hidden=8, iterations=4)


def learner(name):
    task = Reach()
    context = task.draw_contexts(np.random.default_rng(3), 1, DISTRIBUTIONS["paper"])
    env = SimulatedEnvironment(task, 4, 0, lambda rng, n: repeat(context, n), GoalReward(task, context), nthread=1)
    return make_learner(dataclasses.replace(SMALL, learner=name), env, 0)


def written(path, model, **changes):
    config = {
        "learner": "trpo",
        "hidden": 8,
        "observation_size": model.env.observation_size,
        "action_size": 3,
        **changes,
    }
    return write_artifact(path, "policy", policy_weights(model), config=config, seed=0, command="ifo")


@pytest.mark.parametrize("name", ["trpo", "ppo", "sac"])
def test_a_file_holds_the_policy_that_was_learned(name, tmp_path):
    model = learner(name)
    path = written(tmp_path / "a.policy.h5", model, learner=name)
    loaded, shared = Policy.load(read_artifact(path, "policy")), Policy.of(model)
    seen = np.random.default_rng(0).normal(size=(5, model.env.observation_size)).astype(np.float32)
    mean = loaded.act(seen)
    assert mean.shape == (5, 3) and np.abs(mean).max() <= 1
    np.testing.assert_allclose(mean, shared.act(seen), atol=1e-6)
    np.testing.assert_allclose(mean, model.predict(seen, deterministic=True)[0], atol=1e-6)
    drawn = [loaded.act(seen, torch.Generator().manual_seed(seed)) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert not np.array_equal(drawn[0], drawn[2]) and not np.array_equal(drawn[0], mean)
    noise = torch.Generator().manual_seed(1)
    assert not np.array_equal(loaded.act(seen, noise), loaded.act(seen, noise)), "the generator goes on"


def test_drawing_actions_leaves_torchs_own_generator_alone():
    policy, seen = Policy.of(learner("trpo")), np.zeros((2, 7), np.float32)
    with torch.random.fork_rng():
        before = torch.random.get_rng_state()
        policy.act(seen, torch.Generator().manual_seed(1))
        assert torch.equal(torch.random.get_rng_state(), before)


def test_weights_of_another_network_are_refused_in_one_line(tmp_path):
    path = written(tmp_path / "a.policy.h5", learner("trpo"), hidden=9)
    with pytest.raises(ArtifactError, match=r"a\.policy\.h5.*do not fit") as caught:
        Policy.load(read_artifact(path, "policy"))
    assert "\n" not in str(caught.value)


def test_what_is_kept_of_guided_policy_search_has_the_covariance_of_its_last_rollouts():
    """The controller on the robot's own observation: its noise, and what the tracked error would have told."""
    model = learner("gps")
    for _ in range(2):
        ran = model.controller
        model.learn(0)
    expected = on_part(ran, model.last.seen, model.own.gains.shape[2])
    for name, values in expected.arrays().items():
        np.testing.assert_array_equal(model.own.arrays()[name], values, err_msg=name)
    assert (np.linalg.eigvalsh(model.own.covariances - ran.covariances) > -1e-9).all()
    weights = policy_weights(model)
    assert set(weights) == {"weights/gains", "weights/offsets", "weights/covariances"}
    np.testing.assert_array_equal(weights["weights/covariances"], model.own.covariances)


@pytest.mark.parametrize("size", ["hidden", "observation_size", "action_size"])
@pytest.mark.parametrize("name", ["trpo", "sac"])
def test_a_network_is_only_made_as_large_as_its_file(name, size, tmp_path):
    """A network of a million times a million weights needs terabytes."""
    path = written(tmp_path / "a.policy.h5", learner(name), learner=name, **{size: 10**6})
    with pytest.raises(ArtifactError, match=r"a\.policy\.h5.*do not fit the network .* has shape"):
        Policy.load(read_artifact(path, "policy"))


def test_a_policy_of_a_task_of_other_sizes_is_refused(tmp_path):
    model = learner("trpo")
    artifact = read_artifact(written(tmp_path / "a.policy.h5", model))
    seen = first_observation(Reach())
    check_fits(artifact, Reach(), seen)
    assert first_observation(Reach(), expert=True).shape[1] > seen.shape[1]
    with pytest.raises(ArtifactError, match=r"a\.policy\.h5: .* from 7 observations to 3 actions .* has 13 and 3"):
        check_fits(artifact, Reach(), first_observation(Reach(), expert=True))
