"""Frames a second: `RenderPool` on all cores against dm_control's `physics.render`, on the same scenes.

    python benchmarks/render.py

dm_control is measured at two qualities: equal to the pool's, and MuJoCo's default (shadows, multisampling, fine
meshes). Both draw the same contexts and postures of an episode, in turns, in the same run, at the task's frame size;
the figures are medians over the turns. Prints one line of JSON.
"""

from __future__ import annotations

import copy
import json
import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from stages.config.stages import TASKS
from stages.runtime.devices import pick_workers
from stages.simulation.gl import choose_backend

TURNS = 5
POOL_VIDEOS = 240
DM_CONTROL_VIDEOS = {"equal": 16, "default": 1}
MUJOCO_DEFAULTS = {"offsamples": 4, "shadowsize": 4096, "numslices": 28, "numstacks": 16, "numquads": 4}


def main() -> None:
    choose_backend()
    workers = pick_workers(0)
    result = {"benchmark": "render", "workers": workers}
    for task in TASKS:
        result |= {f"{task}_{name}": round(value, 1) for name, value in measure(task, workers).items()}
    print(json.dumps(result))


def measure(task_name: str, workers: int) -> dict[str, float]:
    """Frames a second of one task, and the ratios."""
    from stages.runtime.seeding import generator
    from stages.simulation.batch import rollout
    from stages.simulation.contexts import DISTRIBUTIONS
    from stages.simulation.registry import make_task
    from stages.simulation.render import RenderPool

    task = make_task(task_name)
    rng = generator(0, "benchmark")
    contexts = task.draw_contexts(rng, POOL_VIDEOS, DISTRIBUTIONS["paper"])
    states = task.draw_states(rng, contexts)
    wanted = rng.uniform(-1.0, 1.0, (POOL_VIDEOS, task.action_size))
    qpos = rollout(task, contexts, *states, lambda state, where: wanted).frame_qpos(task)
    fields = task.model_fields(contexts)
    physics = {quality: dm_control_physics(task, quality) for quality in DM_CONTROL_VIDEOS}
    with RenderPool.of(task, workers) as pool:
        runs: dict[str, Callable[[], float]] = {
            "batch_fps": lambda: rate(lambda: pool.render(fields, qpos), qpos.shape[0] * qpos.shape[1]),
            **{
                f"dm_control_{quality}_fps": partial(dm_control_rate, physics[quality], fields, qpos[:n], task)
                for quality, n in DM_CONTROL_VIDEOS.items()
            },
        }
        turns: dict[str, list[float]] = {name: [] for name in runs}
        for run in runs.values():
            run()  # Contexts are made and meshes uploaded at the first frame.
        for _ in range(TURNS):
            for name, run in runs.items():
                turns[name].append(run())
    for each in physics.values():
        each.free()
    fps = {name: statistics.median(values) for name, values in turns.items()}
    ratios = {f"ratio_{quality}": fps["batch_fps"] / fps[f"dm_control_{quality}_fps"] for quality in DM_CONTROL_VIDEOS}
    return fps | ratios


def dm_control_physics(task, quality: str):
    """dm_control's physics of the task at `quality`, with MuJoCo's default framebuffer."""
    from dm_control.mujoco import wrapper

    from stages.simulation.suite import Physics

    model = copy.copy(task.model)
    if quality == "default":
        for name, value in MUJOCO_DEFAULTS.items():
            setattr(model.vis.quality, name, value)
    model.vis.global_.offwidth, model.vis.global_.offheight = 640, 480
    return Physics.from_model(wrapper.MjModel(model))


def rate(draw: Callable[[], object], frames: int) -> float:
    """Frames a second of `draw`, which draws `frames` of them."""
    start = time.perf_counter()
    draw()
    return frames / (time.perf_counter() - start)


def dm_control_rate(physics, fields: dict[str, np.ndarray], qpos: np.ndarray, task) -> float:
    """Frames a second of dm_control over videos (V, T, nq), a call of `render` for each frame."""
    from dm_control import mujoco

    def draw() -> None:
        for video, positions in enumerate(qpos):
            for name, values in fields.items():
                getattr(physics.model, name)[:] = values[video]
            for position in positions:
                physics.data.qpos[:] = position
                physics.forward()
                mujoco.Physics.render(physics, *task.frame_size, camera_id=task.camera)

    return rate(draw, qpos.shape[0] * qpos.shape[1])


if __name__ == "__main__":
    main()
