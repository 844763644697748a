"""`ifo check-task`: what it prints, writes and refuses; and what is said of tasks that later stages may not import."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from artifacts import read_png, write_png

ROOT = Path(__file__).parents[2]
MODULE = """
    from stages.simulation.tasks.reach import Reach

    class Fine(Reach):
        pass

    class Stuck(Reach):
        def draw_states(self, rng, contexts):
            return self.context_state(contexts)

        def outcome(self, distance):
            return distance[:, 0], 0.2 * distance[:, -1]
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module of a user's tasks, in the working folder; its name."""
    (tmp_path / "checked_tasks.py").write_text(textwrap.dedent(MODULE))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("IFO_TASKS", raising=False)
    yield "checked_tasks"
    sys.modules.pop("checked_tasks", None)


@pytest.mark.gl
def test_a_task_that_keeps_its_promises(run_ifo, module):
    code, out, err = run_ifo("check-task", f"{module}:Fine")
    assert (code, out, err) == (0, "runs/checked_tasks-Fine.check.png\n", "")
    sheet = read_png(out.strip())
    assert sheet.shape[0] > 4 * 2 * 48 and sheet.shape[1] > 3 * 2 * 48
    assert run_ifo("check-task", f"{module}:Fine")[0] == 0  # The sheet is replaced.


@pytest.mark.gl
def test_broken_promises_are_a_line_each(run_ifo, module, tmp_path):
    code, out, err = run_ifo("check-task", f"{module}:Stuck", "--out", "new/sheet.png")
    assert (code, out) == (2, "")
    states, idle, sheet = err.splitlines()
    assert states.startswith(f"ifo: task {module}:Stuck: draw_states (checked_tasks.py:8) drew the same states")
    assert idle.startswith(f"ifo: task {module}:Stuck: success_threshold (checked_tasks.py:7) is 0.5, but a robot")
    assert sheet == "contact sheet: new/sheet.png" and (tmp_path / "new/sheet.png").exists()
    code, out, _ = run_ifo("check-task", f"{module}:Stuck", "--json", "--out", "new/sheet.png")
    report = json.loads(out)
    assert (code, report["kind"], report["path"], len(report["problems"])) == (2, "check", "new/sheet.png", 2)
    assert {"contexts", "distances"} <= set(report["promises"])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("raech",), "did you mean reach?"),
        (("checked_tasks:Missing",), "has no Missing"),
        (("reach", "--out", "x.h5"), "expected a file name ending in .png"),
    ],
)
def test_usage_errors(run_ifo, module, words, told):
    code, out, err = run_ifo("check-task", *words)
    assert (code, out, err.count("\n")) == (2, "", 1) and told in err


@pytest.mark.parametrize("stage", ["train-expert", "collect-demos"])
def test_the_first_stage_that_names_a_task_says_what_later_ones_need(run_ifo, calls, module, monkeypatch, stage):
    needed = f"later stages import {module}:Fine only with your permission: export IFO_TASKS={module}:Fine"
    assert needed in run_ifo(stage, f"{module}:Fine")[2].splitlines()
    assert "IFO_TASKS" not in run_ifo(stage, "reach")[2]
    monkeypatch.setenv("IFO_TASKS", f"{module}:Fine")
    assert "IFO_TASKS" not in run_ifo(stage, f"{module}:Fine")[2]


def test_training_a_translator_says_what_later_stages_need(run_ifo, calls, make, monkeypatch):
    monkeypatch.delenv("IFO_TASKS", raising=False)
    path = make("demos", config={"task": "mine:Task"})
    assert "export IFO_TASKS=mine:Task" in run_ifo("train-translator", path)[2]
    assert "IFO_TASKS" not in run_ifo("train-translator", make("demos"))[2]


def test_the_task_of_real_videos_is_typed_and_needs_no_permission(run_ifo, module, tmp_path):
    for video in range(4):
        for moment in range(6):
            picture = np.full((48, 48, 3), 40 * video + moment, np.uint8)
            write_png(tmp_path / "takes" / str(video) / f"{moment}.png", picture)
    videos = sorted((tmp_path / "takes").iterdir())
    words = ("import-demos", *videos, "--frames", "5", "--task", f"{module}:Fine", "--out", "x.demos.h5")
    code, out, err = run_ifo(*words)
    assert (code, out) == (0, "x.demos.h5\n"), err
    assert f"export IFO_TASKS={module}:Fine" in err and "has 25 frames of 48x48 pixels" in err


def test_help_lists_the_tasks_of_plug_ins(tmp_path):
    info = tmp_path / "brought-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: brought\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[ifo.tasks]\nstack-bricks = brought:Stack\n")
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from ifo_cli.main import main; main()"
    command = [sys.executable, "-c", code, "collect-demos", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert "stack-bricks" in done.stdout
