"""What a learning run on reach costs, by part, beside what the machine could do at best.

    python benchmarks/learn_cost.py                # a few iterations of 12,500 samples
    python benchmarks/learn_cost.py --iterations 100

Prints one JSON line: seconds an iteration of drawing frames, encoding and comparing them, physics, the policy's
actions, the update and the rest, and the minutes of 100 iterations. Limits: the drawing pool alone (frames/s), a large
matrix product (GFLOP/s) and what the encoder reaches of it.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import torch
from learn_iteration import EPISODES, SEED, batch_env, iterate

from stages.learners.algorithms import make_learner
from stages.runtime.devices import pick_workers, use_threads
from stages.simulation.gl import choose_backend

GEMM = 2048  # rows and columns
ROUNDS = 5


class Clock:
    """Seconds spent inside the methods that it wraps."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def wrap(self, owner: Any, method: str, part: str) -> None:
        inner: Callable = getattr(owner, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            start = time.perf_counter()
            try:
                return inner(*args, **kwargs)
            finally:
                self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - start

        object.__setattr__(owner, method, timed)  # Some owners are frozen dataclasses.


def best(work: Callable[[], Any]) -> float:
    """Seconds of the fastest of a few rounds."""
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def encoder_flops(model: torch.nn.Module, images: torch.Tensor) -> int:
    """Floating-point operations of encoding `images`."""
    from torch.utils.flop_counter import FlopCounterMode

    with FlopCounterMode(display=False) as counter, torch.no_grad():
        model.encode(images)  # type: ignore[operator]
    return counter.get_total_flops()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=5)
    iterations = parser.parse_args().iterations
    choose_backend()
    from stages.config.presets import defaults

    workers = use_threads(pick_workers(0))
    config = defaults("paper", "learn-policy", "reach")
    env = batch_env(workers)
    try:
        reward: Any = env.reward
        task, pool, model = env.task, env._camera.pool, reward._reward.model
        images = torch.rand(EPISODES, 3, *task.frame_size) * 2 - 1
        qpos = np.tile(task.context_state(env.moment.contexts)[0][:, None], (1, 1, 1))
        a = torch.rand(GEMM, GEMM)
        gemm = 2 * GEMM**3 / best(lambda: a @ a) / 1e9
        with torch.no_grad():
            encoding = encoder_flops(model, images) / best(lambda: model.encode(images)) / 1e9
        drawing = EPISODES / best(lambda: pool.render(env._camera._fields, np.swapaxes(qpos, 0, 1)))
        learner = make_learner(config, env, SEED)
        iterate(learner, EPISODES * task.control_steps)  # The first also pays for what is made once.
        clock = Clock()
        clock.wrap(pool, "render", "frames")
        clock.wrap(model, "encode", "features")
        clock.wrap(reward._reward.target, "image_error", "images")
        clock.wrap(env._simulation, "step", "physics")
        clock.wrap(learner.policy, "forward", "actions")
        clock.wrap(learner, "train", "update")
        total = sum(iterate(learner, EPISODES * task.control_steps) for _ in range(iterations))
    finally:
        env.close()
    parts = {name: round(seconds / iterations, 3) for name, seconds in clock.seconds.items()}
    parts["rest"] = round(total / iterations - sum(parts.values()), 3)
    frames = EPISODES * (task.frames - 1)
    result = {
        "benchmark": "learn_cost",
        "workers": workers,
        "iterations": iterations,
        "minutes_of_100_iterations": round(100 * total / iterations / 60, 2),
        "seconds_an_iteration": parts,
        "frames_per_s": round(frames / parts["frames"]),
        "limit_frames_per_s": round(drawing),
        "encoder_gflops": round(encoding, 1),
        "limit_gemm_gflops": round(gemm, 1),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
