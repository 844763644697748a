"""Discriminators come to prefer what the expert does, stand still during an iteration, and resume bit for bit."""

import numpy as np
import pytest
import torch

from artifacts import UsageError, pack, unpack
from stages.config.stages import PolicyConfig
from stages.learn_policy import learn_policy
from stages.rewards.adversarial import CLIP, GailReward, Schedule, TpilReward
from stages.rewards.discriminators import GailDiscriminator, TpilDiscriminator
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions

SCHEDULE = Schedule(steps=30, rate=1e-3)


def make(kind, stage, squares):
    given = (stage.timing, squares(2, n=16, seed=1), SCHEDULE, 0)
    if kind == "gail":
        return GailReward(*given)
    return TpilReward(*given, unskilled=squares(2, n=16, speed=0, seed=2))


@pytest.mark.parametrize("kind", ["gail", "tpil"])
def test_the_expert_is_rewarded_and_others_are_not(kind, stage, squares):
    reward = make(kind, stage, squares)
    other, like_the_expert = squares(2, speed=0, seed=3), squares(2, seed=4)
    before = stage.perform(reward, other)
    assert np.abs(before).max() < 1  # Nobody has been told apart yet.
    np.testing.assert_array_equal(stage.perform(reward, other), before)
    for _ in range(4):
        reward.iterate()
        stage.perform(reward, other)
    gap = stage.perform(reward, like_the_expert)[:, 2:] - stage.perform(reward, other)[:, 2:]
    assert gap.min() > 0.5
    assert np.abs(stage.perform(reward, like_the_expert)).max() <= CLIP
    assert reward.terms()["told"] > 0.9


def test_tpil_looks_past_the_context_and_gail_does_not(stage, squares):
    """The learner's background is brighter than any demonstration's: GAIL sees that and nothing else."""
    still, moving = squares(2, speed=0, background=120, seed=5), squares(2, background=120, seed=6)
    gaps = {}
    for kind in ("gail", "tpil"):
        reward = make(kind, stage, squares)
        for _ in range(10):
            stage.perform(reward, still)
            reward.iterate()
        gaps[kind] = float((stage.perform(reward, moving)[:, 2:] - stage.perform(reward, still)[:, 2:]).mean())
    assert gaps["tpil"] > 1.5 * max(gaps["gail"], 0.0)
    assert gaps["tpil"] > 0.5


@pytest.mark.parametrize("kind", ["gail", "tpil"])
def test_resumes_bit_for_bit(kind, stage, squares):
    videos = squares(6, seed=7)
    one, other = make(kind, stage, squares), make(kind, stage, squares)
    stage.perform(one, videos)
    one.iterate()
    other.restore(unpack(*pack(one.state())))
    for reward in (one, other):
        stage.perform(reward, videos)
        reward.iterate()
    np.testing.assert_array_equal(stage.perform(one, videos), stage.perform(other, videos))


def test_pairs_are_frames_of_one_video(stage, squares):
    reward = make("gail", stage, squares)
    videos = np.arange(5 * 6, dtype=np.uint8).reshape(5, 6, 1, 1, 1) * np.ones((1, 1, 16, 16, 3), np.uint8)
    before, after = reward.pairs(np.random.default_rng(0), videos)
    first, second = (((images[:, 0, 0, 0] + 1) * 127.5).round().int() for images in (before, after))
    assert (first // 6 == second // 6).all()
    assert ((second % 6).unique() == torch.arange(1, 6)).all()  # never the first frame
    assert (first % 6 == (second % 6 - reward.lag).clamp_min(1)).all()


def test_the_domain_heads_gradient_is_turned_round_on_its_way_into_the_encoder():
    model = TpilDiscriminator((16, 16)).eval()
    images = torch.rand(4, 3, 16, 16)
    _, domain = model.both(images, images)
    domain.sum().backward()
    weight = model.encoder[0].parametrizations.weight.original
    turned = weight.grad.clone()
    weight.grad = None
    model.domain(model.encoder(torch.cat([images, images])))[:, 0].sum().backward()
    torch.testing.assert_close(turned, -weight.grad)


def test_the_encoder_has_the_size_of_the_translators():
    from stages.translation.networks import CompactTranslator

    def size(module):
        return sum(parameter.numel() for parameter in module.parameters())

    ours = size(GailDiscriminator((48, 48)).encoder)
    translator = CompactTranslator((48, 48))
    assert ours >= sum(size(part) for part in (translator.fine, translator.coarse, translator.head))


@pytest.mark.parametrize("option", [{"patience": 5}, {"learner": "sac"}])
def test_what_takes_the_reward_for_unchanging_is_refused(option, tmp_path):
    config = PolicyConfig(reward="tpil", **option)
    with pytest.raises(UsageError, match="--reward tpil changes the reward"):
        learn_policy(config, RunOptions(progress=Progress(quiet=True)), tmp_path / "none.translation.h5")


def test_terms_that_a_reward_lacks_cannot_be_switched_off(tmp_path):
    config = PolicyConfig(reward="gail", without=("feat",))
    with pytest.raises(UsageError, match="--without feat"):
        learn_policy(config, RunOptions(progress=Progress(quiet=True)), tmp_path / "none.translation.h5")
