"""What a training step of the translator costs, by part, beside what the machine could do at best.

    python benchmarks/translator_cost.py

Prints one JSON line: milliseconds a step of drawing the batch, the forward pass (Enc1, Enc2, T and Dec apart), the
backward pass, the optimiser and the rest, on one thread; the minutes of the preset's steps; floating-point operations
a step and what is reached of a large matrix product's rate.
"""

from __future__ import annotations

import argparse
import json
import os
import time

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import torch
from learn_cost import GEMM, Clock, best
from torch.utils.flop_counter import FlopCounterMode

from stages.config.presets import PRESETS
from stages.translation.training import TranslatorTraining

VIDEOS, TIMES, SIZE = 512, 25, 48
WARM = 5  # steps not counted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100)
    steps = parser.parse_args().steps
    torch.set_num_threads(1)
    config = PRESETS["quick"]["train-translator"]
    torch.manual_seed(0)
    frames = torch.randint(0, 256, (VIDEOS, TIMES, SIZE, SIZE, 3), dtype=torch.uint8)
    training = TranslatorTraining(config, frames, 0, "cpu")
    a = torch.rand(GEMM, GEMM)
    gemm = 2 * GEMM**3 / best(lambda: a @ a) / 1e9
    with FlopCounterMode(display=False) as counter:
        training.train_step()
    for _ in range(WARM):
        training.train_step()
    clock = Clock()
    clock.wrap(training, "_batch", "batch")
    for method in ("encode", "translate", "decode"):
        clock.wrap(training.model, method, method)
    clock.wrap(training.model, "encode_context", "context")
    clock.wrap(torch.autograd, "backward", "backward")
    clock.wrap(training.optimiser, "step", "optimiser")
    start = time.perf_counter()
    for _ in range(steps):
        training.train_step()
    total = (time.perf_counter() - start) / steps
    parts = {name: round(1e3 * seconds / steps, 1) for name, seconds in clock.seconds.items()}
    parts["rest"] = round(1e3 * total - sum(parts.values()), 1)
    result = {
        "benchmark": "translator_cost",
        "threads": 1,
        "steps": config.steps,
        "minutes": round(config.steps * total / 60, 1),
        "ms_a_step": parts,
        "gflop_a_step": round(counter.get_total_flops() / 1e9, 2),
        "gflops": round(counter.get_total_flops() / total / 1e9, 1),
        "limit_gemm_gflops": round(gemm, 1),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
