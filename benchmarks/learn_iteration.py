"""Samples a second of one iteration of learn-policy: the batch against a dm_control environment a process.

    python benchmarks/learn_iteration.py

Both do the same work: 250 episodes of 50 control steps in one context, a 48x48 frame at every second step at the
same reduced quality, the frame encoded by the same network and compared with a target, and the same TRPO update.
The baseline steps one dm_control environment in each of as many processes as there are cores, under
Stable-Baselines3's SubprocVecEnv, and encodes where it draws. Prints one line of JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from typing import Any

import gymnasium
import numpy as np

from stages.runtime.devices import pick_workers
from stages.simulation.gl import choose_backend

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # As the command line does, before torch is imported.

TASK, ARCH, SEED, EPISODES = "reach", "compact", 0, 250


def main() -> None:
    choose_backend()
    from stages.config.stages import LearnerConfig
    from stages.learners.algorithms import make_learner
    from stages.runtime.devices import use_threads

    parser = argparse.ArgumentParser()
    parser.add_argument("--threads", type=int, default=0, help="torch threads of the learner (default: one a core)")
    workers = pick_workers(0)
    threads = use_threads(pick_workers(parser.parse_args().threads))
    config = LearnerConfig(episodes=EPISODES)
    batch, processes = batch_env(workers), process_env(workers)
    try:
        learners = {"batch": make_learner(config, batch, SEED), "processes": make_learner(config, processes, SEED)}
        # A number of processes that does not divide the samples makes a few less.
        samples = {"batch": EPISODES * 50, "processes": workers * processes.task.control_steps}
        iterate(learners["batch"], samples["batch"])  # The first also pays for what is made once.
        processes.reset()
        processes.step(np.zeros((workers, 3), np.float32))
        seconds: dict[str, list[float]] = {"batch": [], "processes": []}
        for name in ("batch", "processes", "batch"):
            seconds[name].append(iterate(learners[name], samples[name]))
    finally:
        batch.close()
        processes.close()
    rate = {name: samples[name] / statistics.mean(values) for name, values in seconds.items()}
    result = {
        "benchmark": "learn_iteration",
        "workers": workers,
        "threads": threads,
        "batch_samples_per_s": round(rate["batch"], 1),
        "dm_control_samples_per_s": round(rate["processes"], 1),
        "ratio": round(rate["batch"] / rate["processes"], 2),
    }
    print(json.dumps(result))


def iterate(learner, samples: int) -> float:
    """Seconds of one iteration: rollouts, rewards and update."""
    start = time.perf_counter()
    learner.learn(samples, reset_num_timesteps=False)
    return time.perf_counter() - start


def parts():
    """Task, context, network and target, the same in every process."""
    import torch

    from stages.config.stages import PolicyConfig
    from stages.rewards.tracking import TrackingTarget
    from stages.runtime.seeding import generator
    from stages.simulation.contexts import DISTRIBUTIONS
    from stages.simulation.registry import make_task
    from stages.translation.networks import make_translator

    task = make_task(TASK)
    context = task.draw_contexts(generator(SEED, "context"), 1, DISTRIBUTIONS["paper"])
    torch.manual_seed(SEED)
    model = make_translator(ARCH, task.frame_size).eval()
    features = torch.randn(task.frames, model.feature_size)
    images = torch.rand(task.frames, 3, *task.frame_size) * 2 - 1
    return task, context, model, TrackingTarget(features, images, 1.0, 1.0, PolicyConfig().blur)


def batch_env(workers: int):
    """What learn-policy uses."""
    from stages.environments.simulated import Camera, SimulatedEnvironment
    from stages.environments.timing import Timing
    from stages.rewards.translation import BatchTranslationReward
    from stages.simulation.contexts import repeat
    from stages.simulation.render import RenderPool

    task, context, model, target = parts()
    camera = Camera(task, context, RenderPool.of(task, workers))
    reward = BatchTranslationReward(Timing.regular(task.control_steps, task.frame_every), model, target)
    return SimulatedEnvironment(
        task, EPISODES, SEED, lambda rng, n: repeat(context, n), reward, nthread=workers, camera=camera
    )


def process_env(workers: int):
    """The baseline: a process an environment."""
    from stable_baselines3.common.vec_env import SubprocVecEnv

    from stages.environments.timing import Timing

    env = SubprocVecEnv([lambda k=k: TrackingEnv(k) for k in range(workers)], start_method="spawn")
    # `make_learner` asks the environment how many steps of each process make an iteration.
    env.timing, env.rounds = Timing.regular(50, 2), EPISODES // workers
    return env


class TrackingEnv(gymnasium.Env):
    """One dm_control environment with the translation's reward, as one would write it without the batch."""

    def __init__(self, seed: int):
        import torch

        choose_backend()
        from stages.simulation import suite
        from stages.simulation.contexts import repeat
        from stages.translation.networks import to_images

        torch.set_num_threads(1)
        self._torch, self._frame, self._to_images = torch, suite.frame, to_images
        self.task, context, self._model, self._target = parts()
        self._env = suite.load(TASK, contexts=lambda rng, n: repeat(context, n), seed=seed)
        self._step = 0
        size = 2 * self.task.model.nq + 1
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (self.task.action_size,), np.float32)

    def _observe(self) -> np.ndarray:
        return self.task.observe(self._env.physics.task_state())[0]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        self._step = 0
        self._env.reset()
        return self._observe(), {}

    def step(self, action: np.ndarray):
        self._env.step(action)
        self._step += 1
        return self._observe(), self._reward(), self._step == self.task.control_steps, False, {}

    def _reward(self) -> float:
        frame, between = divmod(self._step, self.task.frame_every)
        if between or frame >= self.task.frames:
            return 0.0
        torch, target = self._torch, self._target
        with torch.no_grad():
            image = self._to_images(torch.from_numpy(self._frame(self._env.physics, self.task).copy()))[None]
            features = target.feature_error(self._model.encode(image), frame)
            return -float(features + target.image_error(image, frame))

    def close(self) -> None:
        self._env.close()


if __name__ == "__main__":
    main()
