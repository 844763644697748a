"""Frames a second: `RenderPool` on all cores against dm_control's `physics.render`, on the same scenes.

    python benchmarks/render.py

dm_control is measured at three qualities: equal to the pool's; MuJoCo's default (multisampling, fine meshes) on the
task's own scene, whose headlight casts no shadows; and the default on the same scene with a light that does, as scenes
of dm_control's suite have: the pool draws that scene, too, for the comparison. All draw the same contexts and postures
at 48x48, in turns, in the same run; the figures are medians over the turns. Prints one line of JSON.
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from stages.run import pick_workers
from stages.simulation.gl import choose_backend

TASK = "reach"
TURNS = 5
POOL_VIDEOS = 240
DM_CONTROL_VIDEOS = {"equal": 16, "default": 4, "shadows": 1}
BATCH = {"equal": "batch_fps", "default": "batch_fps", "shadows": "batch_lit_fps"}
MUJOCO_DEFAULTS = {"offsamples": 4, "shadowsize": 4096, "numslices": 28, "numstacks": 16, "numquads": 4}


def main() -> None:
    choose_backend()
    from stages.seeding import generator
    from stages.simulation.batch import rollout
    from stages.simulation.contexts import DISTRIBUTIONS
    from stages.simulation.render import RenderPool
    from stages.simulation.tasks import make_task

    task = make_task(TASK)
    rng = generator(0, "benchmark")
    contexts = task.draw_contexts(rng, POOL_VIDEOS, DISTRIBUTIONS["paper"])
    states = task.draw_states(rng, contexts)
    wanted = rng.uniform(-1.0, 1.0, (POOL_VIDEOS, task.action_size))
    qpos = rollout(task, contexts, *states, lambda state, where: wanted).frame_qpos(task)
    fields = task.model_fields(contexts)

    workers = pick_workers(0)
    physics = {quality: dm_control_physics(task.build(), quality) for quality in DM_CONTROL_VIDEOS}
    with (
        RenderPool(task.build().to_xml_string(), *task.frame_size, workers=workers) as pool,
        RenderPool(lit(task.build()).to_xml_string(), *task.frame_size, workers=workers) as lit_pool,
    ):
        runs: dict[str, Callable[[], float]] = {
            "batch_fps": lambda: rate(lambda: pool.render(fields, qpos), qpos.shape[0] * qpos.shape[1]),
            "batch_lit_fps": lambda: rate(lambda: lit_pool.render(fields, qpos), qpos.shape[0] * qpos.shape[1]),
            **{
                f"dm_control_{quality}_fps": partial(
                    dm_control_rate, physics[quality], fields, qpos[:n], task.frame_size
                )
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
    result = {
        "benchmark": "render",
        "workers": workers,
        **{name: round(value, 1) for name, value in fps.items()},
        **{
            f"ratio_{quality}": round(fps[BATCH[quality]] / fps[f"dm_control_{quality}_fps"], 1)
            for quality in DM_CONTROL_VIDEOS
        },
    }
    print(json.dumps(result))


def dm_control_physics(root, quality: str):
    """dm_control's physics of an MJCF model at `quality`, with MuJoCo's default framebuffer."""
    from stages.simulation.suite import Physics

    if quality != "equal":
        root.visual.quality.set_attributes(**MUJOCO_DEFAULTS)
    if quality == "shadows":
        lit(root)
    getattr(root.visual, "global").set_attributes(offwidth=640, offheight=480)
    return Physics.from_xml_string(root.to_xml_string(), root.get_assets())


def lit(root):
    """The scene with a light that casts shadows where the quality has any."""
    root.worldbody.add("light", name="light", pos=(0, 0, 4))
    return root


def rate(draw: Callable[[], object], frames: int) -> float:
    """Frames a second of `draw`, which draws `frames` of them."""
    start = time.perf_counter()
    draw()
    return frames / (time.perf_counter() - start)


def dm_control_rate(physics, fields: dict[str, np.ndarray], qpos: np.ndarray, size: tuple[int, int]) -> float:
    """Frames a second of dm_control over videos (V, T, nq), a call of `render` for each frame."""
    from dm_control import mujoco

    def draw() -> None:
        for video, positions in enumerate(qpos):
            for name, values in fields.items():
                getattr(physics.model, name)[:] = values[video]
            for position in positions:
                physics.data.qpos[:] = position
                physics.forward()
                mujoco.Physics.render(physics, *size, camera_id="context")

    return rate(draw, qpos.shape[0] * qpos.shape[1])


if __name__ == "__main__":
    main()
