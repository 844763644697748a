"""`import ifo` costs nothing, and everything that it offers is there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ifo
from artifacts import write_artifact

ROOT = Path(__file__).parents[2]
SECONDS = 0.05
HEAVY = ("gymnasium", "h5py", "mujoco", "numpy", "pydantic", "torch", "typer")


def python(code: str, **environment: str) -> str:
    """What a new Python process prints."""
    import os

    kept = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, env=kept | environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_importing_it_is_quick_and_loads_nothing_heavy():
    code = (
        "import sys, time; start = time.process_time(); import ifo; print(time.process_time() - start);"
        f"print([name for name in {HEAVY} if name in sys.modules])"
    )
    runs = [python(code).splitlines() for _ in range(3)]
    assert min(float(seconds) for seconds, _ in runs) < SECONDS
    assert {loaded for _, loaded in runs} == {"[]"}


def test_every_name_is_there_and_listed():
    for name in ifo.__all__:
        assert getattr(ifo, name) is not None, name
        assert name in dir(ifo)
    with pytest.raises(AttributeError, match="no attribute 'stages_of'"):
        _ = ifo.stages_of


@pytest.mark.gl
@pytest.mark.parametrize("use", ["ifo.make_task('reach')", "ifo.TranslationReward", "ifo.suite", "ifo.scene"])
def test_the_backend_is_chosen_before_mujoco_is_imported(use):
    """As no variable asks for one, mujoco would otherwise try a window."""
    code = (
        f"import ifo, os; {use}; import mujoco; from stages.simulation.gl import choose_backend;"
        "print(os.environ['MUJOCO_GL'] == choose_backend())"
    )
    assert python(code) == "True"


def test_a_task_of_ones_own_needs_no_further_permission(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "tests" / "examples")
    monkeypatch.delenv("IFO_TASKS", raising=False)
    task = ifo.make_task("glide:Glide")
    assert isinstance(task, ifo.Task)
    assert task.frames == 25
    with pytest.raises(ifo.UsageError, match="did you mean reach"):
        ifo.make_task("raech")


@pytest.mark.gl
def test_a_task_can_be_checked():
    report = ifo.check_task(ifo.make_task("reach"))
    assert report.problems == () and report.frames.shape == (20, 48, 48, 3)


def test_a_file_is_read_and_verified_for_what_it_is(tmp_path):
    frames = np.zeros((2, 3, 8, 8, 3), np.uint8)
    path = tmp_path / "x.demos.h5"
    write_artifact(path, "demos", {"frames": frames}, config={}, seed=0, command="ifo", environment={})
    assert ifo.verify(path).kind == "demos"
    assert ifo.read_artifact(path)["frames"].shape == (2, 3, 8, 8, 3)
    with pytest.raises(ifo.ArtifactError, match="expected a policy or an expert"):
        ifo.load_policy(path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ifo.ArtifactError):
        ifo.verify(path)
