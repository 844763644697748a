"""One step of the translator's training, against closed forms: rates, clipping, AdamW, averaged weights, batches."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from stages.config.stages import TranslatorConfig
from stages.translation import training as module
from stages.translation.loop import held_out_count
from stages.translation.losses import translation_losses
from stages.translation.training import TranslatorTraining, on_gpu

CONFIG = TranslatorConfig(steps=1000, videos=4, frames=2, swap_colours=False)


def coded(n: int = 6, times: int = 5) -> torch.Tensor:
    """Videos (n, times, 16, 16, 3) whose red says which video it is and whose green which time."""
    frames = torch.zeros(n, times, 16, 16, 3, dtype=torch.uint8)
    frames[..., 0] = torch.arange(n)[:, None, None, None]
    frames[..., 1] = torch.arange(times)[:, None, None]
    return frames


def noise(n: int = 6) -> torch.Tensor:
    return torch.randint(0, 256, (n, 5, 16, 16, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(2))


def start(config: TranslatorConfig, frames: torch.Tensor | None = None) -> TranslatorTraining:
    return TranslatorTraining(config, noise() if frames is None else frames, 3, "cpu")


def values(model: torch.nn.Module) -> dict[str, np.ndarray]:
    return {name: value.detach().double().numpy().copy() for name, value in model.named_parameters()}


def gradients(training: TranslatorTraining) -> dict[str, np.ndarray]:
    named = training.model.named_parameters()
    return {name: value.grad.double().numpy().copy() for name, value in named if value.grad is not None}


@pytest.mark.parametrize(
    ("steps", "step", "share"),
    [
        (1000, 0, 1 / 200),
        (1000, 99, 0.5 * 0.5 * (1 + math.cos(math.pi * 0.099))),
        (1000, 199, 0.5 * (1 + math.cos(math.pi * 0.199))),
        (1000, 500, 0.5),
        (1000, 999, 0.02),  # the cosine would end at zero
        (5000, 200, 0.5 * (1 + math.cos(math.pi * 0.04))),
        (100, 9, 0.5 * 0.5 * (1 + math.cos(math.pi * 0.09))),  # a short run warms up in a fifth of its steps
        (100, 30, 0.5 * (1 + math.cos(math.pi * 0.3))),
        (4, 0, 0.5 * (1 + math.cos(0.0))),
    ],
)
def test_the_rate_warms_up_and_falls_along_a_cosine_to_a_floor(steps, step, share):
    training = start(dataclasses.replace(CONFIG, steps=steps, learning_rate=3e-3))
    training.step = step
    training.train_step()
    assert [group["lr"] for group in training.optimiser.param_groups] == [pytest.approx(3e-3 * share)]


def test_a_constant_rate_stays():
    training = start(dataclasses.replace(CONFIG, schedule="constant", learning_rate=2e-3))
    for step in (0, 700):
        training.step = step
        training.train_step()
        assert [group["lr"] for group in training.optimiser.param_groups] == [2e-3]


@pytest.mark.parametrize("schedule", ["cosine", "constant"])
def test_gradients_are_clipped_with_the_cosine_schedule_only(schedule, monkeypatch):
    def norm() -> float:
        training = start(dataclasses.replace(CONFIG, schedule=schedule))
        training.train_step()
        return math.sqrt(sum(np.square(value).sum() for value in gradients(training).values()))

    monkeypatch.setattr(module, "GRADIENT_NORM", 1e9)
    whole = norm()
    monkeypatch.setattr(module, "GRADIENT_NORM", whole / 4)
    assert norm() == pytest.approx(whole / 4 if schedule == "cosine" else whole, rel=1e-5)


@pytest.mark.parametrize(("schedule", "second"), [("cosine", 0.99), ("constant", 0.999)])
def test_weights_follow_adamw(schedule, second):
    """Kingma and Ba's update with decoupled weight decay, written out, on the gradients that the steps leave."""
    # So few steps that there is no warm-up: at a low rate the two schedules' updates would hardly differ.
    training = start(dataclasses.replace(CONFIG, steps=4, schedule=schedule, weight_decay=0.1, learning_rate=1e-2))
    expected, mean, square = values(training.model), {}, {}
    for step in range(1, 4):
        training.train_step()
        rate = training.optimiser.param_groups[0]["lr"]
        for name, gradient in gradients(training).items():
            mean[name] = 0.9 * mean.get(name, 0.0) + 0.1 * gradient
            square[name] = second * square.get(name, 0.0) + (1 - second) * gradient**2
            change = mean[name] / (1 - 0.9**step) / (np.sqrt(square[name] / (1 - second**step)) + 1e-8)
            expected[name] = expected[name] * (1 - rate * 0.1) - rate * change
    for name, value in values(training.model).items():
        np.testing.assert_allclose(value, expected[name], rtol=1e-4, atol=2e-6, err_msg=name)


def test_averaged_weights_are_an_exponential_mean_that_starts_fast():
    training = start(dataclasses.replace(CONFIG, ema=0.25, learning_rate=1e-2, schedule="constant"))
    average = values(training.average)
    for decay in (2 / 11, 0.25, 0.25):  # (1 + step) / (10 + step) while that is less than --ema
        training.train_step()
        now = values(training.model)
        average = {name: decay * average[name] + (1 - decay) * now[name] for name in now}
    for name, value in values(training.average).items():
        np.testing.assert_allclose(value, average[name], rtol=1e-5, atol=1e-7, err_msg=name)
        assert not np.array_equal(value, now[name]), name


def test_without_an_average_the_weights_themselves_are_judged():
    training = start(dataclasses.replace(CONFIG, ema=0.0))
    assert training.average is training.model


def test_the_gradient_is_that_of_the_weighted_losses():
    config = dataclasses.replace(CONFIG, schedule="constant", lambda_rec=0.5, lambda_align=3.0, motion_weight=2.0)
    for without, weights in (((), (1.0, 0.5, 3.0)), (("trans",), (0.0, 0.5, 3.0)), (("rec", "align"), (1.0, 0.0, 0.0))):
        training = start(dataclasses.replace(config, without=without, rec_frames=1))
        videos, contexts, sources, reconstructed, _ = training._batch()
        assert len(reconstructed) == 1
        losses = translation_losses(training.model, videos, contexts, sources, 2.0, reconstructed)
        total = sum(weight * losses[name] for weight, name in zip(weights, ("trans", "rec", "align"), strict=True))
        found = torch.autograd.grad(total, list(training.model.parameters()), allow_unused=True)
        told = training.train_step()
        for name in ("trans", "rec", "align"):
            assert float(told[name]) == pytest.approx(float(losses[name].detach()), rel=1e-5)
        for parameter, gradient in zip(training.model.parameters(), found, strict=True):
            if gradient is not None:
                torch.testing.assert_close(parameter.grad, gradient, rtol=1e-4, atol=1e-5)


def decoded(images: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Which video and which time frames (..., 3, H, W) of `coded` videos show."""
    shown = ((images[..., :2, 0, 0] + 1) * 127.5).round().long().numpy()
    return shown[..., 0], shown[..., 1]


def test_a_batch_is_of_different_videos_at_the_same_later_times():
    config = dataclasses.replace(CONFIG, pairings=2)
    training = start(config, coded())
    seen_videos, seen_times, seen_shifts = set(), set(), set()
    for step in range(25):
        training.step = step
        images, contexts, sources, *_ = training._batch()
        videos, times = decoded(images)
        own, first = decoded(contexts)
        assert (videos == own[:, None]).all() and len(set(own)) == 4, "a frame's context is its own video's"
        assert (first == 0).all(), "frame 0 is the context"
        assert (times == times[0]).all() and (np.diff(times[0]) > 0).all() and times.min() >= 1
        shifts = {tuple((source.numpy() - np.arange(4)) % 4) for source in sources}
        assert len(shifts) == 2 and all(len(set(shift)) == 1 and shift[0] for shift in shifts)
        seen_videos |= set(own)
        seen_times |= set(times[0])
        seen_shifts |= {shift[0] for shift in shifts}
    assert seen_videos == set(range(6)) and seen_times == {1, 2, 3, 4} and seen_shifts == {1, 2, 3}


def test_a_batch_takes_what_there_is_where_more_is_asked_for():
    training = start(dataclasses.replace(CONFIG, videos=16, frames=9, pairings=9, rec_frames=9), coded(n=3))
    images, contexts, sources, reconstructed, _ = training._batch()
    _, times = decoded(images)
    assert sorted(decoded(contexts)[0]) == [0, 1, 2]
    assert (times == [1, 2, 3, 4]).all()
    assert sorted(int(source[0]) for source in sources) == [1, 2]
    assert reconstructed is None, "all frames are reconstructed"


def test_frames_reconstructed_are_different_ones():
    training = start(dataclasses.replace(CONFIG, frames=4, rec_frames=3), coded())
    for step in range(5):
        training.step = step
        assert len(set(training._batch()[3].tolist())) == 3


@pytest.mark.parametrize(
    ("demonstrations", "wanted", "count"), [(3000, 256, 256), (100, 256, 20), (104, 21, 20), (9, 256, 2), (4, 2, 2)]
)
def test_at_most_a_fifth_and_at_least_two_demonstrations_are_held_out(demonstrations, wanted, count):
    assert held_out_count(demonstrations, wanted) == count


def test_without_a_gpu_videos_stay_where_they_are():
    frames = coded()
    assert on_gpu(frames, "cpu") is frames


@pytest.mark.parametrize(("align", "aligned"), [("dtw", [8, 20]), ("none", [])])
def test_videos_are_aligned_after_a_fifth_and_after_half_of_the_steps(align, aligned, monkeypatch):
    training = start(dataclasses.replace(CONFIG, steps=40, align=align))
    found, seen = np.tile([0, 2, 2, 3, 4], (6, 1)), []
    monkeypatch.setattr(module, "video_index", lambda *given: seen.append((training.step, given)) or found)
    for step in range(41):
        training.step = step
        training.align()
    assert [step for step, _ in seen] == aligned
    for _, (model, frames, reference, device) in seen:
        assert model is training.average and torch.equal(frames, noise())
        assert torch.equal(reference, noise()[0, 0]) and device == "cpu"
    assert training._index is (found if aligned else None)
    assert ("index" in training.state()) == bool(aligned)


@pytest.mark.parametrize("compile", [True, False])
def test_losses_are_compiled_if_asked_for(compile, monkeypatch):
    compiled = []
    monkeypatch.setattr(torch, "compile", lambda function, mode: compiled.append((function, mode)) or function)
    start(dataclasses.replace(CONFIG, compile=compile)).train_step()
    assert compiled == ([(translation_losses, "default")] if compile else [])
