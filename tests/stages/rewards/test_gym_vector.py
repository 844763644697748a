"""The vector form gives every environment what the plain form would."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import ifo
from artifacts import UsageError
from stages.rewards.gym_vector import TranslationRewardVector
from stages.rewards.gym_wrapper import TranslationReward
from tests.stages.rewards.test_gym_wrapper import TARGET, Squares, write

pytestmark = pytest.mark.filterwarnings("ignore:TranslationReward. the environment's frames do not change")


class Ending(Squares):
    """Ends after as many steps as it is told."""

    def __init__(self, after=100, cut=False, **options):
        super().__init__(**options)
        self._after, self._cut, self._steps = after, cut, 0

    def reset(self, **options):
        self._steps = 0
        return super().reset(**options)

    def step(self, action):
        self._steps += 1
        observation, reward, *_, info = super().step(action)
        ends = self._steps == self._after
        return observation, reward, ends and not self._cut, ends and self._cut, info


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write(tmp_path_factory.mktemp("squares"), TARGET)


def vector(path, *kinds, mode=AutoresetMode.NEXT_STEP, **options):
    env = SyncVectorEnv([lambda kind=kind: Ending(**kind) for kind in kinds], autoreset_mode=mode)
    return TranslationRewardVector(env, path, 2, **options)


def plain_form(path, kind, actions):
    """Rewards and infos of one environment in the plain form, which starts again after an end as Gymnasium does."""
    env = TranslationReward(Ending(**kind), path, 2)
    env.reset()
    rewards, infos, ended = [], [], False
    for action in actions:
        if ended:
            env.reset()
            rewards.append(0.0)
            infos.append({})
            ended = False
            continue
        _, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
        infos.append(info)
        ended = terminated or truncated
    return rewards, infos


@pytest.mark.parametrize("kinds", [({}, {}, {}), ({"after": 5}, {"after": 9, "cut": True}, {"after": 12}, {})])
def test_every_environment_is_paid_as_if_it_were_alone(path, kinds):
    actions = np.random.default_rng(0).uniform(-1, 1, (24, len(kinds), 1)).astype(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = vector(path, *kinds)
        env.reset(seed=0)
        got = [env.step(action) for action in actions]
        env.close()
        expected = [plain_form(path, kind, actions[:, k]) for k, kind in enumerate(kinds)]
    for k, (rewards, infos) in enumerate(expected):
        np.testing.assert_allclose([step[1][k] for step in got], rewards, rtol=1e-5, atol=1e-6)
        for term in ("reward_feat", "reward_img"):
            wanted = [info.get(term, 0.0) for info in infos]
            np.testing.assert_allclose([step[4][term][k] for step in got], wanted, rtol=1e-5, atol=1e-6)
    assert np.count_nonzero([step[1] for step in got]) > 5 and got[0][4]["env_reward"].tolist() == [7.0] * len(kinds)


def test_a_mask_restarts_only_its_environments(path):
    env = vector(path, {"after": 4}, {}, mode=AutoresetMode.DISABLED)
    env.reset(seed=0)
    still = np.zeros((2, 1), np.float32)
    for _ in range(4):
        env.step(still)
    env.reset(options={"reset_mask": np.array([True, False])})
    assert env._steps.tolist() == [0, 4]
    assert env.step(still)[1].tolist() == [0.0, 0.0]
    paid = env.step(still)[1]
    assert paid[0] == pytest.approx(plain_form(path, {}, still[:, 0].repeat(2)[:, None])[0][1], rel=1e-5)
    env.close()


def test_what_cannot_be_seen_is_refused(path):
    with pytest.raises(UsageError, match="autoreset_mode NEXT_STEP or DISABLED"):
        vector(path, {}, mode=AutoresetMode.SAME_STEP)
    with pytest.raises(UsageError, match="render_mode is None"):
        TranslationRewardVector(SyncVectorEnv([lambda: Squares(render_mode=None)]), path, 2)


def test_what_it_cannot_notice_is_warned_of_once(path):
    with pytest.warns(UserWarning, match="TranslationRewardVector: episodes of 4 steps end at frame 2") as caught:
        env = vector(path, {"after": 4, "cut": True}, {"after": 4, "cut": True})
        env.reset(seed=0)
        for _ in range(12):
            env.step(np.zeros((2, 1), np.float32))
        env.close()
    assert len([one for one in caught if "episodes of 4 steps" in str(one.message)]) == 1


def test_environments_made_by_gymnasium_learn_from_it(path):
    envs = gymnasium.make_vec("test/Squares-v0", num_envs=2, vectorization_mode="sync", render_mode="rgb_array")
    env = ifo.TranslationRewardVector(envs, path, 2)
    env.reset(seed=0)
    rewards = np.stack([env.step(np.zeros((2, 1), np.float32))[1] for _ in range(10)])
    env.close()
    assert np.count_nonzero(rewards[:, 0]) <= 5 and np.isfinite(rewards).all()
