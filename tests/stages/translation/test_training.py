"""Training learns, repeats under a seed, and resumes bit for bit."""

import dataclasses

import numpy as np
import pytest
import torch

from artifacts import pack, unpack
from stages.config.presets import defaults
from stages.config.stages import LOSSES, TranslatorConfig
from stages.translation.evaluation import evaluate_translator
from stages.translation.training import GRADIENT_NORM, TranslatorTraining, parallel_groups

CONFIG = TranslatorConfig(steps=40, videos=4, frames=2)


def moving_squares(n: int, seed: int = 0) -> torch.Tensor:
    """Videos (n, 6, 16, 16, 3) of a square that moves right, on a background whose colour is the context."""
    rng = np.random.default_rng(seed)
    frames = np.empty((n, 6, 16, 16, 3), np.uint8)
    frames[:] = rng.integers(0, 120, (n, 1, 1, 1, 3))
    for video, row in zip(frames, rng.integers(2, 11, n), strict=True):
        for t in range(6):
            video[t, row : row + 4, 2 * t : 2 * t + 4] = 230
    return torch.from_numpy(frames)


def run(config: TranslatorConfig, steps: int, seed: int = 3, device: str = "cpu") -> TranslatorTraining:
    training = TranslatorTraining(config, moving_squares(32), seed, device)
    for _ in range(steps):
        training.train_step()
    return training


def assert_same(one: TranslatorTraining, other: TranslatorTraining) -> None:
    for name, value in one.model.state_dict().items():
        assert torch.equal(value, other.model.state_dict()[name]), name
    for name, value in one.average.state_dict().items():
        assert torch.equal(value, other.average.state_dict()[name]), name


def test_same_seed_same_weights_other_seed_other_weights():
    first, second, other = run(CONFIG, 4), run(CONFIG, 4), run(CONFIG, 4, seed=4)
    assert_same(first, second)
    assert any(
        not torch.equal(value, other.model.state_dict()[name]) for name, value in first.model.state_dict().items()
    )


@pytest.mark.parametrize(
    "options",
    [
        {"schedule": "cosine"},
        {"schedule": "constant"},
        {"arch": "real"},
        {"augment": True},
        {"arch": "real", "augment": True, "groups": 2},
    ],
)
def test_a_restored_training_goes_on_bit_for_bit(options):
    config = dataclasses.replace(CONFIG, **options)
    whole, begun = run(config, 7), run(config, 3)
    resumed = TranslatorTraining(config, moving_squares(32), 3, "cpu")
    resumed.restore(unpack(*pack(begun.state())))
    for _ in range(4):
        resumed.train_step()
    assert resumed.step == whole.step
    assert_same(whole, resumed)


@pytest.mark.parametrize("loss", ["trans", "rec", "align"])
def test_a_loss_that_is_switched_off_does_not_train(loss):
    plain, without = run(CONFIG, 3), run(dataclasses.replace(CONFIG, without=(loss,)), 3)
    same = [torch.equal(v, without.model.state_dict()[k]) for k, v in plain.model.state_dict().items()]
    assert not all(same)
    everything_off = run(dataclasses.replace(CONFIG, without=("trans", "rec", "align"), weight_decay=0.0), 3)
    assert_same(
        everything_off, run(dataclasses.replace(CONFIG, without=("trans", "rec", "align"), weight_decay=0.0), 0)
    )


# With dropout features take longer to learn than pictures, and at the compact network's rate longer than a test.
@pytest.mark.parametrize(
    ("arch", "rate", "ratio"), [("compact", 1e-3, 0.6), pytest.param("real", 3e-3, 0.9, marks=pytest.mark.slow)]
)
def test_learns_to_translate_a_moving_square(arch, rate, ratio):
    config = defaults("quick", "train-translator", choice=arch)
    options = {"arch": arch, "steps": 400, "frames": 3, "learning_rate": rate, "swap_colours": False, "ema": 0.98}
    config = dataclasses.replace(config, **options)
    training = TranslatorTraining(config, moving_squares(512), 0, "cpu")
    held_out = moving_squares(16, seed=9)
    before = evaluate_translator(training.average, held_out, "cpu")
    for _ in range(config.steps):
        training.train_step()
    after = evaluate_translator(training.average, held_out, "cpu")
    assert after["copy_psnr"] == pytest.approx(before["copy_psnr"])
    assert after["psnr"] > after["copy_psnr"] + 3.0
    assert after["feature_ratio"] < ratio, "the feature target must lead towards the true video"


def test_batches_follow_from_the_seed_alone():
    training = TranslatorTraining(CONFIG, moving_squares(32), 3, "cpu")
    videos, contexts, sources, reconstructed, _ = training._batch()
    assert len(reconstructed) == 1 and int(reconstructed[0]) < 2
    assert videos.shape == (4, 2, 3, 16, 16)
    assert contexts.shape == (4, 3, 16, 16)
    assert sorted(sources[0].tolist()) == [0, 1, 2, 3]
    assert not (sources[0] == torch.arange(4)).any(), "no video is translated into its own context"
    again = TranslatorTraining(CONFIG, moving_squares(32), 3, "cpu")._batch()
    assert torch.equal(videos, again[0])


def test_dropout_follows_from_the_seed_and_leaves_torchs_random_state_alone():
    config = dataclasses.replace(CONFIG, arch="real")
    training = TranslatorTraining(config, moving_squares(32), 3, "cpu")
    batch = training._batch()

    def losses(step: int, group: int = 0) -> list[float]:
        training.step = step
        with training._dropout(group):
            return [float(v.detach()) for v in training._losses(training.model, *batch[:3]).values()]

    with torch.random.fork_rng():
        state = torch.random.get_rng_state()
        first = losses(0)
        assert torch.equal(torch.random.get_rng_state(), state)
        torch.manual_seed(1)
        assert losses(0) == first
    assert losses(1) != first and losses(0, group=1) != first


@pytest.mark.parametrize("ema", [0.0, 0.9])
def test_held_out_metrics_are_without_dropout_and_training_goes_on_with_it(ema):
    training = run(dataclasses.replace(CONFIG, arch="real", ema=ema), 1)
    held_out = moving_squares(4, seed=9)
    first, second = (evaluate_translator(training.average, held_out, "cpu") for _ in range(2))
    assert first == second
    assert training.model.training


@pytest.mark.parametrize("arch", ["compact", "real"])
def test_a_step_of_two_groups_has_the_mean_of_their_losses_and_gradients(arch):
    config = dataclasses.replace(CONFIG, arch=arch)
    one, two = (
        TranslatorTraining(dataclasses.replace(config, groups=groups), moving_squares(32), 3, "cpu")
        for groups in (1, 2)
    )
    assert torch.equal(one._batch()[0], two._batch(0)[0]), "the first group is what there is without a second"
    assert not torch.equal(two._batch(0)[0], two._batch(1)[0])
    losses, gradients = [], []
    for group in range(2):
        one.optimiser.zero_grad()
        losses.append(one._backward(group))
        gradients.append([p.grad.clone() for p in one.model.parameters() if p.grad is not None])
    got = two.train_step()
    for name, value in got.items():
        assert float(value) == pytest.approx(np.mean([float(part[LOSSES.index(name)]) for part in losses]), rel=1e-6)
    # Clipping has scaled what the step left there.
    whole = [p.grad for p in two.model.parameters() if p.grad is not None]
    mean = [(a + b) / 2 for a, b in zip(*gradients, strict=True)]
    norm = torch.cat([g.flatten() for g in mean]).norm()
    for a, b in zip(whole, mean, strict=True):
        torch.testing.assert_close(a, b * min(1.0, GRADIENT_NORM / float(norm)), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    "options", [{}, {"without": ("rec", "align")}, {"augment": True, "pairings": 2}, {"arch": "paper"}]
)
def test_threads_that_share_the_groups_change_no_bit(options):
    config = dataclasses.replace(CONFIG, groups=3, **options)
    alone, together = (TranslatorTraining(config, moving_squares(32), 3, "cpu", threads=threads) for threads in (1, 2))
    for _ in range(3):
        losses = [training.train_step() for training in (alone, together)]
        assert losses[0] == losses[1]
    assert_same(alone, together)


def test_an_error_in_a_thread_ends_the_step(monkeypatch):
    training = TranslatorTraining(dataclasses.replace(CONFIG, groups=2), moving_squares(32), 3, "cpu", threads=2)
    batch = training._batch
    monkeypatch.setattr(training, "_batch", lambda group: batch(group) if group == 0 else 1 / 0)
    with pytest.raises(ZeroDivisionError):
        training.train_step()


def test_groups_are_parallel_only_where_threads_are_independent():
    config = dataclasses.replace(CONFIG, groups=4)
    assert parallel_groups(config, "cpu", 4) == 4
    assert parallel_groups(config, "cpu", 2) == 2
    assert parallel_groups(config, "cuda", 4) == 1
    assert parallel_groups(dataclasses.replace(config, compile=True), "cpu", 4) == 1
    assert parallel_groups(dataclasses.replace(config, arch="real"), "cpu", 4) == 1, "dropout has one generator"


def test_reconstructs_as_many_frames_as_asked_and_the_batch_stays_the_same():
    config = dataclasses.replace(CONFIG, frames=4)
    every, one = (
        TranslatorTraining(dataclasses.replace(config, rec_frames=frames), moving_squares(32), 3, "cpu")
        for frames in (0, 1)
    )
    seen = set()
    for step in range(20):
        every.step = one.step = step
        plain, chosen = every._batch(), one._batch()
        assert plain[3] is None
        assert torch.equal(plain[0], chosen[0])
        assert len(chosen[3]) == 1
        seen.update(chosen[3].tolist())
    assert seen == set(range(4))


@pytest.mark.parametrize(("rec_frames", "trans_frames", "apart"), [(1, 2, True), (2, 3, False), (0, 1, False)])
def test_translates_as_many_frames_as_asked_and_others_than_it_reconstructs(rec_frames, trans_frames, apart):
    config = dataclasses.replace(CONFIG, frames=4, rec_frames=rec_frames)
    every, some = (
        TranslatorTraining(dataclasses.replace(config, trans_frames=frames), moving_squares(32), 3, "cpu")
        for frames in (0, trans_frames)
    )
    counts, shared = np.zeros(4), 0
    for step in range(60):
        every.step = some.step = step
        plain, chosen = every._batch(), some._batch()
        assert plain.translated is None and torch.equal(plain.videos, chosen.videos)
        if rec_frames:
            assert torch.equal(plain.reconstructed, chosen.reconstructed)
            shared += len(set(chosen.reconstructed.tolist()) & set(chosen.translated.tolist()))
        assert len(set(chosen.translated.tolist())) == trans_frames
        counts[chosen.translated] += 1
    assert (shared == 0) == (apart or not rec_frames)
    np.testing.assert_allclose(counts / 60, trans_frames / 4, atol=0.2)


def test_mirrors_and_swaps_colours_only_where_asked():
    def videos(**options) -> torch.Tensor:
        config = dataclasses.replace(CONFIG, videos=16, **options)
        return TranslatorTraining(config, moving_squares(32), 3, "cpu")._batch()[0]

    plain = videos(mirror=False, swap_colours=False)
    for options, change in (
        ({"mirror": True, "swap_colours": False}, lambda v: v.flip(-1)),
        ({"mirror": False, "swap_colours": True}, lambda v: v[:, :, [0, 2, 1]]),
    ):
        altered, changed = videos(**options), change(plain)
        same = [torch.equal(a, b) for a, b in zip(altered, plain, strict=True)]
        other = [torch.equal(a, b) for a, b in zip(altered, changed, strict=True)]
        assert all(a or b for a, b in zip(same, other, strict=True))
        assert any(same) and not all(same)
