"""Training on a GPU: what the CPU computes, compiled or not, without waiting for the GPU."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from artifacts import pack, unpack
from stages.config.stages import TranslatorConfig
from stages.translation import training as module
from stages.translation.evaluation import evaluate_translator
from stages.translation.training import TranslatorTraining

pytestmark = pytest.mark.cuda
CONFIG = TranslatorConfig(steps=40, videos=4, frames=2, amp=False)
# The paper's training, but for its size.
PAPER = {"arch": "paper", "frames": 1, "schedule": "constant", "rec_frames": 0, "swap_colours": False, "ema": 0.0}
STEPS = 4  # A compiled step is captured at the second or third call, and replayed from then on.


@pytest.fixture(autouse=True)
def exact(monkeypatch):
    """Convolutions in full single precision, by algorithms that repeat."""
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)
    monkeypatch.setattr(torch.backends.cudnn, "deterministic", True)


def videos(n: int = 32, size: int = 16) -> torch.Tensor:
    """Videos (n, 6, size, size, 3) of noise."""
    return torch.from_numpy(np.random.default_rng(0).integers(0, 256, (n, 6, size, size, 3), dtype=np.uint8))


def begun(device: str = "cuda", size: int = 16, **options) -> TranslatorTraining:
    return TranslatorTraining(dataclasses.replace(CONFIG, **options), videos(size=size), 3, device)


def losses(training: TranslatorTraining, steps: int = STEPS) -> np.ndarray:
    """The losses of each step (steps, 3)."""
    return np.array([[float(value) for value in training.train_step().values()] for _ in range(steps)])


def change(training: TranslatorTraining, seed_weights: dict[str, torch.Tensor]) -> torch.Tensor:
    """How far all weights are from `seed_weights`, in one vector on the CPU."""
    weights = training.model.state_dict()
    return torch.cat([(weights[name].cpu() - value).flatten() for name, value in seed_weights.items()])


@pytest.mark.parametrize("options", [{}, PAPER, {"mirror": True, "groups": 2}, {"augment": True, "pairings": 2}])
def test_a_step_is_that_of_the_cpu(options):
    here, there = begun("cpu", **options), begun("cuda", **options)
    before = {name: value.clone() for name, value in here.model.state_dict().items()}
    for name, value in there.model.state_dict().items():
        assert torch.equal(value.cpu(), before[name]), name
    here._backward(0), there._backward(0)
    one, other = (
        torch.cat([p.grad.cpu().flatten() for p in training.model.parameters() if p.grad is not None])
        for training in (here, there)
    )
    assert (one - other).norm() < 1e-4 * one.norm()
    np.testing.assert_allclose(losses(there), losses(here), rtol=1e-3)
    moved = change(here, before)
    # Adam divides gradients by their size, rounding errors of next to nothing included.
    assert (change(there, before) - moved).norm() < 0.1 * moved.norm()


@pytest.mark.parametrize("options", [{}, PAPER])
def test_mixed_precision_stays_near(options):
    # L_align compares features of what is near: where it has fallen to a tenth, it differs most.
    np.testing.assert_allclose(losses(begun(**options, amp=True)), losses(begun(**options)), rtol=0.1)


@pytest.mark.parametrize(
    "options",
    [PAPER, {**PAPER, "amp": True}, {"groups": 2}],
    ids=["graphs", "graphs in mixed precision", "groups, without graphs"],
)
def test_a_compiled_step_is_a_plain_one(options, monkeypatch):
    # What torch 2.11 compiles expects gradients in a layout in which cuDNN does not leave them by its algorithms that
    # repeat, nor where maps have one pixel (frames of 16).
    monkeypatch.setattr(torch.backends.cudnn, "deterministic", False)
    plain, compiled = (losses(begun(size=32, **options, compile=compile), 6) for compile in (False, True))
    np.testing.assert_allclose(compiled[:STEPS], plain[:STEPS], rtol=0.1 if options.get("amp") else 1e-2)
    np.testing.assert_allclose(compiled, plain, rtol=0.1)  # By then rounding errors have grown.


def test_a_compiled_network_with_dropout_trains():
    training = begun(arch="real", compile=True)
    assert np.isfinite(losses(training)).all()


@pytest.mark.parametrize("options", [{}, PAPER, {"arch": "real", "augment": True, "groups": 2}, {"amp": True}])
def test_a_restored_training_goes_on_bit_for_bit(options):
    whole, first = begun(**options), begun(**options)
    losses(whole, 7), losses(first, 3)
    resumed = begun(**options)
    resumed.restore(unpack(*pack(first.state())))
    losses(resumed, 4)
    for name, value in whole.model.state_dict().items():
        assert torch.equal(value, resumed.model.state_dict()[name]), name


@pytest.mark.parametrize(("before", "after"), [("cpu", "cuda"), ("cuda", "cpu")])
def test_a_training_goes_on_on_another_device(before, after):
    moved, stayed = begun(before), begun(before)
    losses(moved, 3), losses(stayed, 3)
    there = begun(after)
    there.restore(unpack(*pack(moved.state())))
    np.testing.assert_allclose(losses(there), losses(stayed), rtol=1e-2)


def test_videos_that_do_not_fit_are_sent_batch_by_batch(monkeypatch):
    there = begun()
    monkeypatch.setattr(module, "GPU_SHARE", 0.0)
    here = begun()
    assert there._frames.is_cuda and not here._frames.is_cuda
    for one, other in zip(there._batch()[:2], here._batch()[:2], strict=True):
        assert one.is_cuda and torch.equal(one, other)


@pytest.mark.parametrize("share", [0.5, 0.0])
@pytest.mark.parametrize("options", [PAPER, {"mirror": True, "amp": True}])
def test_a_step_does_not_wait_for_the_gpu(monkeypatch, share, options):
    monkeypatch.setattr(module, "GPU_SHARE", share)
    training = begun(**options)
    losses(training, 2)
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        training.train_step()
    finally:
        torch.cuda.set_sync_debug_mode("default")


def test_held_out_metrics_are_those_of_the_cpu():
    here, there = begun("cpu"), begun("cuda")
    expected = evaluate_translator(here.average, videos(6), "cpu")
    found = evaluate_translator(there.average, videos(6), "cuda")
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-4)
