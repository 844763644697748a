"""Frames: what they show, and that the number of processes changes no byte of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from stages.simulation.render import PIECE, RenderPool, TileRenderer, pieces, reduced

pytestmark = pytest.mark.gl

# What a context says, and how many pixels (median) change where it says the contrary. Strike's arm is thin.
SHOWN = {
    "reach": {"table_rgb": 500, "arm_rgb": 40, "goal": 10, "initial_qpos": 20},
    "push": {"table_rgb": 500, "arm_rgb": 40, "goal": 10, "cylinder": 10, "initial_qpos": 20},
    "sweep": {"table_rgb": 500, "arm_rgb": 40, "balls": 10, "initial_qpos": 20},
    "strike": {"table_rgb": 500, "arm_rgb": 30, "goal": 10, "initial_qpos": 20},
}
CASES = [(task, name, pixels) for task, names in SHOWN.items() for name, pixels in names.items()]


@pytest.fixture(scope="module")
def renderer(task):
    made = TileRenderer(task.model, *task.frame_size, oversampling=task.oversampling)
    yield made
    made.close()


@pytest.fixture
def first_frames(task, renderer):
    """A function contexts -> their first frames (n, H, W, 3)."""

    def drawn(contexts):
        qpos, _ = task.context_state(contexts)
        return renderer.render(task.model_fields(contexts), qpos[:, None])[:, 0]

    return drawn


def changed(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Pixels (n,) of each frame that differ visibly."""
    return (np.abs(one.astype(int) - other).max(axis=-1) > 20).sum(axis=(1, 2))


def poses(task, contexts, frames, seed=0):
    """Joint positions (n, frames, nq): the contexts' own, but for random postures of the arm."""
    qpos = np.repeat(task.context_state(contexts)[0][:, None], frames, axis=1)
    arm = np.random.default_rng(seed).uniform(-0.3, 2.6, (*qpos.shape[:2], task.action_size))
    qpos[..., task.posture] = arm
    return qpos


def test_frames_do_not_depend_on_the_number_of_processes(task, draw):
    contexts = draw("paper", 13)
    qpos = poses(task, contexts, task.frames)
    fields = task.model_fields(contexts)
    drawn = []
    for workers in (1, 2):
        with RenderPool.of(task, workers=workers) as pool:
            drawn += [pool.render(fields, qpos), pool.render(fields, qpos)]
    for other in drawn[1:]:
        assert np.array_equal(drawn[0], other)


@pytest.mark.parametrize(("videos", "frames"), [(1, 1), (7, 25), (300, 1), (2, PIECE), (3, 2 * PIECE + 5), (0, 25)])
def test_pieces_cover_every_frame_once_and_fit_the_buffer(videos, frames):
    covered = np.zeros((videos, frames), int)
    for cut in pieces(videos, frames):
        assert covered[cut].size <= PIECE
        covered[cut] += 1
    assert (covered == 1).all()


def test_a_long_video_is_drawn_in_order(task, draw, renderer):
    contexts = draw("paper", 1)
    qpos = poses(task, contexts, 1).repeat(PIECE + 3, axis=1)
    qpos[0, :, 0] = np.linspace(0, 2 * np.pi, PIECE + 3)
    fields = task.model_fields(contexts)
    video = renderer.render(fields, qpos)[0]
    for j in (0, 1, PIECE - 1, PIECE, PIECE + 2):
        alone = renderer.render(fields, qpos[:, j : j + 1])[0]
        assert changed(alone, video[j : j + 1])[0] <= 3


def test_frames_are_those_of_each_video_alone(task, draw, renderer):
    contexts = draw("paper", 5)
    fields = task.model_fields(contexts)
    qpos, _ = task.context_state(contexts)
    together = renderer.render(fields, qpos[:, None])[:, 0]
    for k in range(5):
        alone = renderer.render({n: v[k : k + 1] for n, v in fields.items()}, qpos[k : k + 1, None])[0]
        assert changed(alone, together[k : k + 1])[0] <= 3


@pytest.mark.parametrize("task", ["reach", "push", "strike"], indirect=True)
def test_frames_show_the_goal_in_red(draw, first_frames):
    contexts = draw("paper", 100)
    frames = first_frames(contexts).astype(int)
    red = (frames[..., 0] > 150) & (frames[..., 1:].max(axis=-1) < 60)
    assert np.median(red.sum(axis=(1, 2))) >= 8
    assert (red.sum(axis=(1, 2)) >= 3).mean() >= 0.98  # The arm may stand before the disc.


@pytest.mark.parametrize(("task", "name", "at_least"), CASES, indirect=["task"])
def test_frames_show_what_a_context_says(draw, first_frames, name, at_least):
    contexts = draw("paper", 50)
    other = contexts | {name: 1.0 - contexts[name] if name.endswith("rgb") else -contexts[name]}
    assert np.median(changed(first_frames(contexts), first_frames(other))) >= at_least


@pytest.mark.parametrize("task", ["reach", "push"], indirect=True)
def test_frames_show_distractors_only_where_they_are_visible(draw, first_frames):
    contexts = draw("paper", 50)
    none = contexts | {"distractor_visible": np.zeros_like(contexts["distractor_visible"])}
    count = contexts["distractor_visible"].sum(axis=1)
    differ = changed(first_frames(contexts), first_frames(none))
    assert (differ[count == 0] == 0).all()
    assert np.median(differ[count >= 2]) > 10
    assert (differ[count >= 2] > 0).all()


def test_frames_differ_with_the_viewpoint(draw, first_frames):
    contexts = draw("paper", 20)
    turned = contexts | {"azimuth": contexts["azimuth"] + 45.0}
    assert changed(first_frames(contexts), first_frames(turned)).min() > 100


def test_frames_have_the_tasks_size(task, draw, first_frames):
    expected = (36, 64, 3) if task.name == "sweep" else (48, 48, 3)
    frames = first_frames(draw("fixed"))
    assert frames.shape == (1, *expected)
    assert frames.std() > 10


def test_a_renderer_may_be_closed_twice(task):
    renderer = TileRenderer(task.model, *task.frame_size, oversampling=task.oversampling)
    renderer.close()
    renderer.close()


SCRIPT = """
import numpy as np

from stages.simulation.gl import choose_backend


def main():
    choose_backend()
    from stages.simulation import suite
    from stages.simulation.render import reduced, RenderPool, TileRenderer
    from stages.simulation.registry import distribution, make_task

    task = make_task("reach")
    contexts = task.draw_contexts(np.random.default_rng(0), 6, distribution("paper"))
    fields = task.model_fields(contexts)
    qpos = np.repeat(task.context_state(contexts)[0][:, None], 25, axis=1)
    env = suite.load("reach", seed=0, pixels=True)
    env.reset()
    with RenderPool.of(task, workers=2) as pool:
        pool.render(fields, qpos)
    renderer = TileRenderer(task.model, 48, 48)
    renderer.render(fields, qpos)
    env.step(np.zeros(3))
    renderer.close()
    env.close()
    print("closed")


if __name__ == "__main__":
    main()
"""


def test_closed_contexts_leave_nothing_to_complain_about(tmp_path):
    script = tmp_path / "script.py"
    root = Path(__file__).parents[3]
    script.write_text(f"import sys\nsys.path.insert(0, {str(root)!r})\n{SCRIPT}")
    child = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60)
    assert child.returncode == 0, child.stderr
    assert child.stdout == "closed\n"
    assert child.stderr == ""


def test_reduced_frames_are_means_of_blocks():
    drawn = np.random.default_rng(0).integers(0, 256, (2, 6, 9, 3), dtype=np.uint8)
    blocks = [[drawn[:, 3 * i : 3 * i + 3, 3 * j : 3 * j + 3].mean(axis=(1, 2)) for j in range(3)] for i in range(2)]
    expected = np.stack([np.stack(row, axis=1) for row in blocks], axis=1)
    frames = reduced(drawn, 3)
    assert frames.dtype == np.uint8
    assert np.abs(frames - expected).max() <= 0.5
    assert reduced(drawn, 1) is drawn


def test_fine_pictures_have_shadows_and_smooth_edges(task, draw):
    import mujoco

    contexts = draw("fixed", 1)
    qpos, fields = task.context_state(contexts)[0][:, None], task.model_fields(contexts)
    drawn = {}
    for fine in (False, True):
        renderer = TileRenderer(task.model, 96, 96, fine=fine)
        drawn[fine] = renderer.render(fields, qpos)[0, 0]
        renderer._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        shadowless = renderer.render(fields, qpos)[0, 0]
        renderer.close()
    colours = [len(np.unique(picture.reshape(-1, 3), axis=0)) for picture in drawn.values()]
    assert colours[1] > 1.2 * colours[0], "edges are blended"
    darker = shadowless.astype(int).sum(axis=-1) - drawn[True].sum(axis=-1, dtype=int)
    assert (darker > 20).sum() > 20 > (darker < -20).sum(), "shadows"
    assert np.abs(drawn[True].astype(int) - drawn[False]).mean() < 15, "of the same scene"
    assert task.model.vis.quality.offsamples == 0, "the task's own model renders as before"
