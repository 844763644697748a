"""A training step of the translator on two cores: groups in parallel threads, against torch's own threads.

Prints one JSON line with medians in milliseconds: one group of 16 videos on one thread and on torch's two threads, two
groups of 8 videos one after the other and in two threads (preset quick), and the same with --trans-frames 2. All are
measured in turn in one process, so that a busy moment hits all of them. `ratio` is the step rate of preset quick
relative to one group on torch's two threads. Operations are counted from the shapes of preset quick; `gflops` is their
rate, `matrix_gflops` that of a product of two 1024x1024 matrices in two threads.
"""

from __future__ import annotations

import json
import os
import statistics
import time
from concurrent.futures import ThreadPoolExecutor

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import torch
from torch.utils.flop_counter import FlopCounterMode

from stages.config.presets import PRESETS
from stages.config.stages import TranslatorConfig
from stages.translation.training import TranslatorTraining

ROUNDS = 25
SIDE = 1024  # of the matrices
CORES = 2


def training(threads: int, **options: int) -> TranslatorTraining:
    frames = torch.randint(0, 256, (64, 25, 48, 48, 3), dtype=torch.uint8)
    return TranslatorTraining(TranslatorConfig(**options), frames, 0, "cpu", threads=threads)


def flops(training: TranslatorTraining) -> int:
    """Operations of the forward and backward passes of a step."""
    with FlopCounterMode(display=False) as counter:
        for group in range(training.config.groups):
            training._backward(group)
    return counter.get_total_flops()


def product(_: int) -> None:
    first = torch.ones(SIDE, SIDE)
    torch.mm(first, first)


def main() -> None:
    quick = PRESETS["quick"]["train-translator"]
    halves = {"videos": quick.videos, "groups": quick.groups}
    variants = {  # torch's threads, and the training
        "one_group": (1, training(1, videos=16)),
        "one_group_torch_threads": (CORES, training(1, videos=16)),
        "two_groups": (1, training(1, **halves)),
        "two_groups_threads": (1, training(CORES, **halves)),
        "two_groups_threads_half_decoded": (1, training(CORES, **halves, trans_frames=2)),
    }
    torch.set_num_threads(1)
    operations = flops(training(1, **halves))
    times: dict[str, list[float]] = {name: [] for name in variants}
    products = []
    with ThreadPoolExecutor(CORES) as pool:
        for _ in range(ROUNDS):
            for name, (threads, made) in variants.items():
                torch.set_num_threads(threads)
                start = time.perf_counter()
                made.train_step()
                times[name].append(time.perf_counter() - start)
            torch.set_num_threads(1)
            start = time.perf_counter()
            list(pool.map(product, range(CORES)))
            products.append(time.perf_counter() - start)
    medians = {name: statistics.median(values) for name, values in times.items()}
    best = medians["two_groups_threads"]
    figures = {f"{name}_ms": round(1e3 * value, 1) for name, value in medians.items()}
    ratio = round(medians["one_group_torch_threads"] / best, 2)
    rates = {
        "gflops": round(operations / best / 1e9, 1),
        "matrix_gflops": round(CORES * 2 * SIDE**3 / statistics.median(products) / 1e9, 1),
    }
    print(json.dumps({"benchmark": "translator_threads", **figures, "ratio": ratio, **rates}))


if __name__ == "__main__":
    main()
