"""What discriminators learn from, step by step: pairs, losses, memory, and the logits that are paid."""

import math

import numpy as np
import pytest
import torch

from stages.rewards import adversarial
from stages.rewards.adversarial import GailReward, Schedule, TpilReward
from stages.rewards.discriminators import GailDiscriminator, TpilDiscriminator, expert_loss, frozen

T = 6


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(adversarial, "BATCH", 8)


def numbered(n, first=0):
    """Videos (n, 6, 16, 16, 3) whose every frame has its own grey."""
    return np.arange(first, first + n * T, dtype=np.uint8).reshape(n, T, 1, 1, 1) * np.ones((1, 1, 16, 16, 3), np.uint8)


def greys(images):
    return ((images[:, 0, 0, 0] + 1) * 127.5).round().int().numpy()


def make(kind, stage, steps=2, **options):
    given = (stage.timing, numbered(4), Schedule(steps, 1e-3), 5)
    return GailReward(*given) if kind == "gail" else TpilReward(*given, unskilled=numbered(4, 100), **options)


def test_all_rounds_of_episodes_of_an_iteration_are_remembered(stage):
    reward = make("gail", stage)
    rounds = [numbered(2, first=20), numbered(2, first=60), numbered(2, first=90)]
    for videos in rounds:
        stage.perform(reward, videos)
    reward.iterate()
    (memory,) = reward._memory
    np.testing.assert_array_equal(memory[:, 1:], np.concatenate(rounds)[:, 1:])
    stage.perform(reward, rounds[0])
    reward.iterate()
    assert [len(seen) for seen in reward._memory] == [6, 2]


@pytest.mark.parametrize("kind", ["gail", "tpil"])
def test_the_reward_is_the_clipped_logit_of_a_frame_and_the_one_before_it(kind, stage):
    reward = make(kind, stage)
    lag = 2 if kind == "gail" else 3
    model = reward._model
    with torch.no_grad():
        for parameter in model.expert.parameters():
            parameter.mul_(40)
    reward._judging = frozen(model)
    videos = np.random.default_rng(0).integers(0, 256, (3, T, 16, 16, 3), dtype=np.uint8)
    got = stage.perform(reward, videos)
    with torch.no_grad():
        for frame in range(1, T):
            logits = reward._judging(reward.images(videos[:, max(frame - lag, 1)]), reward.images(videos[:, frame]))
            np.testing.assert_allclose(got[:, frame - 1], logits.clamp(-5, 5).numpy(), rtol=1e-5)


@pytest.mark.parametrize("kind", ["gail", "tpil"])
def test_the_learners_last_four_iterations_are_remembered(kind, stage):
    reward = make(kind, stage, steps=1)
    for k in range(6):
        stage.perform(reward, numbered(2, first=20 * k))
        reward.iterate()
    assert len(reward._memory) == 4
    for k, seen in enumerate(reward._memory, 2):
        assert seen.shape == (2, T, 16, 16, 3)
        np.testing.assert_array_equal(seen[:, 1:], numbered(2, first=20 * k)[:, 1:])
        np.testing.assert_array_equal(seen[:, 0], seen[:, 1], "frame 0 is never shown: another stands for it")
    drawn = {
        int(grey) // 20 for seed in range(20) for grey in greys(reward.learner_pairs(np.random.default_rng(seed))[1])
    }
    assert drawn == {2, 3, 4, 5}


def test_an_iteration_takes_as_many_steps_as_scheduled_and_tells_how_many_pairs_were_told(stage, monkeypatch):
    reward = make("gail", stage, steps=3)
    assert math.isnan(reward.terms()["told"])
    stage.perform(reward, numbered(2, 60))
    shares, losses = iter((8, 6, 4)), []

    def loss(rng):
        logits = torch.full((16,), -1.0)
        logits[: next(shares)] = 1.0  # of the first eight, the expert's, so many are told; of the others all
        parameter = next(reward._model.parameters())
        losses.append(parameter.detach().clone())
        return parameter.sum(), logits

    monkeypatch.setattr(reward, "loss", loss)
    before = reward._judging
    reward.iterate()
    assert reward._judging is not before and len(losses) == 3
    assert reward.terms()["told"] == pytest.approx((16 + 14 + 12) / 48)
    assert not torch.equal(losses[0], losses[1]), "each step moves the weights"


def test_gail_is_shown_the_experts_pairs_first(stage):
    reward = make("gail", stage)
    stage.perform(reward, numbered(2, 60))
    reward.iterate()
    seen = []
    reward._model = lambda before, after: seen.append((greys(before), greys(after))) or torch.zeros(len(before))
    loss, logits = reward.loss(np.random.default_rng(0))
    (before, after) = seen[0]
    assert len(logits) == 16 and float(loss) == pytest.approx(math.log(2))
    assert (after[:8] < 24).all() and (after[8:] >= 60).all()
    assert set(after - before) <= {0, 1, 2}


def test_tpil_is_shown_experts_the_unskilled_and_the_learner_and_hides_whose_context_it_is(stage):
    reward = make("tpil", stage)
    stage.perform(reward, numbered(2, 60))
    reward.iterate()
    seen = []
    expert, domain = torch.linspace(-1, 1, 24), torch.linspace(-2, 1, 48)

    class Model:
        def both(self, before, after):
            seen.append((greys(before), greys(after)))
            return expert, domain

    reward._model = Model()
    loss, logits = reward.loss(np.random.default_rng(0))
    (before, after) = seen[0]
    assert logits is expert
    for frames in (before, after):
        assert (
            (frames[:8] < 24).all() and (frames[8:16] >= 100).all() and ((frames[16:] >= 60) & (frames[16:] < 72)).all()
        )
    told = 0.0
    for k in range(48):  # of the pairs' first frames, then of their second ones
        learner = k % 24 >= 16
        told += (2 if learner else 1) * math.log(1 + math.exp(-domain[k] if learner else domain[k])) / 48
    assert float(loss) == pytest.approx(float(expert_loss(expert, 8)) + 0.5 * told, rel=1e-5)


def test_both_classes_weigh_the_same_however_many_there_are():
    logits = torch.tensor([0.3, -1.0, 2.0, 0.5, -0.7])
    values = logits.numpy()
    expected = 0.5 * (np.log1p(np.exp(-values[:2])).mean() + np.log1p(np.exp(values[2:])).mean())
    assert float(expert_loss(logits, 2)) == pytest.approx(float(expected), rel=1e-6)


def test_pairs_come_from_all_videos_and_end_at_every_frame_but_the_first(stage):
    reward = make("tpil", stage)
    pairs = [reward.pairs(np.random.default_rng(seed), numbered(4)) for seed in range(30)]
    before, after = (np.concatenate([greys(pair[k]) for pair in pairs]) for k in range(2))
    assert set(after // T) == set(range(4)) and set(after % T) == {1, 2, 3, 4, 5}
    assert (before == after // T * T + np.maximum(after % T - 3, 1)).all()


@pytest.mark.parametrize("size", [(16, 16), (48, 48), (20, 28)])
def test_discriminators_take_frames_of_any_size(size):
    images = torch.rand(5, 3, *size) * 2 - 1
    gail, tpil = GailDiscriminator(size), TpilDiscriminator(size)
    assert gail(images, images.flip(0)).shape == (5,)
    tpil.eval()
    expert, domain = tpil.both(images, images.flip(0))
    assert expert.shape == (5,) and domain.shape == (10,)
    torch.testing.assert_close(tpil(images, images.flip(0)), expert, rtol=1e-4, atol=1e-5)
    assert not torch.allclose(tpil(images, images.flip(0)), tpil(images.flip(0), images)), "their order counts"


def test_a_frozen_copy_stays_as_it_was():
    model = GailDiscriminator((16, 16))
    copy = frozen(model)
    images = torch.rand(2, 3, 16, 16)
    before = copy(images, images)
    assert not copy.training and model.training
    assert not any(parameter.requires_grad for parameter in copy.parameters())
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.1)
    torch.testing.assert_close(copy(images, images), before)


@pytest.mark.parametrize("kind", ["gail", "tpil"])
def test_a_discriminator_starts_from_the_runs_seed_alone(kind, stage):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        state = torch.random.get_rng_state()
        first = make(kind, stage)
        assert torch.equal(torch.random.get_rng_state(), state)
        torch.manual_seed(2)
        second = make(kind, stage)
    for one, other in zip(first._model.parameters(), second._model.parameters(), strict=True):
        assert torch.equal(one, other)
    assert first._optimiser.defaults["lr"] == 1e-3 and first._optimiser.defaults["betas"] == (0.5, 0.99)
