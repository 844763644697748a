"""A training step of the translator on a GPU, preset paper: plain, in mixed precision, compiled, and what bounds it.

    python benchmarks/cuda_translator.py

Prints one JSON line: milliseconds a step (median of rounds that end with the GPU idle) and the minutes of the preset's
steps for each variant, `null` and the reason where one fails; floating-point operations a step; what moving the
weights, their gradients and Adam's moments takes at least; the GPU's own rates of a large product in bfloat16 and of a
large copy, and the floor that they set; and launches a plain step, each of which costs the CPU some microseconds.
Where there is no GPU it says so in the line, and measures nothing.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch.utils.flop_counter import FlopCounterMode

from stages.config.presets import PRESETS
from stages.config.stages import TranslatorConfig
from stages.translation.training import TranslatorTraining

VIDEOS, TIMES, SIZE = 2744, 25, 48  # as many videos as the preset trains on
ROUNDS = 5
WARM = 5  # steps that are not counted; a compiled step is captured in the first three
GEMM, COPY = 8192, 2**30  # rows and columns; bytes
VARIANTS: dict[str, dict[str, Any]] = {
    "plain": {"amp": False},
    "amp": {"amp": True},
    "compiled": {"amp": False, "compile": True},
    "compiled_amp": {"amp": True, "compile": True},
}
BYTES_A_WEIGHT = 4 * (1 + 4 + 3)  # the gradient written; it, weight and two moments read; three of these written


def milliseconds(work: Callable[[], Any], times: int) -> float:
    """Of one of `times` runs of `work`, the GPU's included; median of rounds."""
    spent = []
    for _ in range(ROUNDS):
        torch.cuda.synchronize()
        start = time.perf_counter()
        for _ in range(times):
            work()
        torch.cuda.synchronize()
        spent.append(1e3 * (time.perf_counter() - start) / times)
    return statistics.median(spent)


def launches(training: TranslatorTraining) -> int:
    """Kernels of one step."""
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profile:
        training.train_step()
        torch.cuda.synchronize()
    return sum(event.device_type == torch.autograd.DeviceType.CUDA for event in profile.events())


def rates() -> tuple[float, float]:
    """TFLOP/s of a large matrix product in bfloat16, and TB/s of a large copy, bytes read and written counted."""
    a, b = (torch.randn(GEMM, GEMM, device="cuda", dtype=torch.bfloat16) for _ in range(2))
    source = torch.randint(0, 256, (COPY,), dtype=torch.uint8, device="cuda")
    target = torch.empty_like(source)
    torch.matmul(a, b), target.copy_(source)
    product, copy = milliseconds(lambda: torch.matmul(a, b), 20), milliseconds(lambda: target.copy_(source), 20)
    return 2 * GEMM**3 / product / 1e9, 2 * COPY / copy / 1e9


def measure(config: TranslatorConfig, frames: torch.Tensor, steps: int) -> dict[str, float]:
    """Milliseconds a step, minutes of all steps, and seconds that the first steps take."""
    training = TranslatorTraining(config, frames, 0, "cuda")
    start = time.perf_counter()
    for _ in range(WARM):
        losses = training.train_step()
    if not all(bool(value.isfinite()) for value in losses.values()):
        raise RuntimeError(f"losses are not finite: {losses}")
    begin = time.perf_counter() - start
    step = milliseconds(training.train_step, steps)
    return {"ms": round(step, 3), "minutes": round(config.steps * step / 6e4, 2), "first_steps_s": round(begin, 1)}


def attempted(work: Callable[[], Any]) -> Any:
    """What `work` returns, or why it fails: what it lacks, a compiler for instance, says nothing of the others."""
    try:
        return work()
    except Exception as error:
        return {"ms": None, "reason": " ".join(f"{type(error).__name__}: {error}".split())[:300]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    given = parser.parse_args()
    if not torch.cuda.is_available():
        print(json.dumps({"benchmark": "cuda_translator", "skipped": "torch sees no GPU here"}))
        return
    paper = PRESETS["paper"]["train-translator"]
    frames = torch.randint(0, 256, (VIDEOS, TIMES, SIZE, SIZE, 3), dtype=torch.uint8)
    result: dict[str, Any] = {"benchmark": "cuda_translator", "gpu": torch.cuda.get_device_name(), "steps": paper.steps}
    for name in given.variants:
        config = replace(paper, **VARIANTS[name])
        result[name] = attempted(lambda config=config: measure(config, frames, given.steps))
        print(f"{name}: {result[name]}", file=sys.stderr, flush=True)
    training = TranslatorTraining(replace(paper, amp=True), frames, 0, "cuda")
    with FlopCounterMode(display=False) as counter:
        training.train_step()
    weights = sum(parameter.numel() for parameter in training.model.parameters())
    product, copy = rates()
    arithmetic, moving = counter.get_total_flops() / product / 1e9, weights * BYTES_A_WEIGHT / copy / 1e9
    result |= {
        "million_weights": round(weights / 1e6, 1),
        "gflop_a_step": round(counter.get_total_flops() / 1e9, 1),
        "bf16_tflops": round(product, 1),
        "copy_tb_a_second": round(copy, 2),
        "floor_arithmetic_ms": round(arithmetic, 3),
        "floor_weights_ms": round(moving, 3),
        "launches_a_plain_step": attempted(lambda: launches(training)),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
