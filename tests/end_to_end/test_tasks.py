"""Every command takes every task: the paper's four, dm_control's suite, and a user's own file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from artifacts import read_artifact, write_artifact
from ifo_cli.main import main
from stages.simulation.tasks.push import CANONICAL_GOAL

pytestmark = pytest.mark.gl
EXAMPLES = Path(__file__).parents[1] / "examples"
SMALL = {
    "train-expert": ("--iterations", 2, "--episodes", 4, "--test-contexts", 4, "--test-episodes", 2),
    "collect-demos": ("-n", 10, "--keep-failures", "--contexts", "narrow"),
    "train-translator": ("--steps", 2, "--held-out", 2),
    "translate": ("-n", 2),
    "learn-policy": ("--iterations", 1, "--episodes", 4),
    "evaluate": ("--episodes", 2),
}


@pytest.fixture
def ifo(tmp_path, monkeypatch, capsys):
    """A function that runs one command at its smallest, in this process, and returns what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(stage: str, *words: object) -> str:
        code = main([stage, *map(str, (*words, *SMALL[stage], "--preset", "toy", "--workers", 1))])
        captured = capsys.readouterr()
        assert code == 0, captured.err
        return captured.out.strip()

    return run


@pytest.fixture
def pipeline(ifo):
    """A function that runs all six commands on a task and returns the evaluation's figures."""

    def run(task: str) -> dict:
        path = ifo("collect-demos", task, "--expert", ifo("train-expert", task))
        for stage in ("train-translator", "translate", "learn-policy"):
            path = ifo(stage, path)
        return json.loads(ifo("evaluate", path, "--json"))

    return run


@pytest.mark.parametrize("task", ["push", "sweep", "strike"])
def test_the_papers_tasks(pipeline, tmp_path, task):
    figures = pipeline(task)
    assert 0 <= figures["normalised_distance"] < 5
    demos = read_artifact(tmp_path / "runs" / f"{task}-toy.demos.h5", "demos")
    assert demos["frames"].shape == (10, 25, *((36, 64, 3) if task == "sweep" else (48, 48, 3)))


@pytest.mark.slow  # Its expert learns by SAC.
def test_a_task_of_dm_controls_suite(pipeline, tmp_path):
    figures = pipeline("dm:reacher-easy")
    assert 0 <= figures["normalised_distance"] <= 1
    demos = read_artifact(tmp_path / "runs" / "dm-reacher-easy-toy.demos.h5", "demos")
    assert demos.config["task"] == "dm:reacher-easy"
    assert demos["frames"].shape == (10, 25, 48, 48, 3)
    assert (demos["initial_distance"] == 1).all()


def test_a_users_own_file(pipeline, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    monkeypatch.setenv("IFO_TASKS", "glide:Glide")
    figures = pipeline("glide:Glide")
    assert 0 <= figures["normalised_distance"] < 5
    demos = read_artifact(tmp_path / "runs" / "glide-Glide-toy.demos.h5", "demos")
    assert len(np.unique(demos["contexts/goal"], axis=0)) == 10


def test_vary_chooses_what_differs_between_videos(ifo, capsys):
    expert = ifo("train-expert", "push")
    demos = read_artifact(ifo("collect-demos", "push", "--expert", expert, "--vary", "colour,elevation"), "demos")
    differ = {name for name in demos.names("contexts") if len(np.unique(demos[name], axis=0)) > 1}
    assert {"contexts/table_rgb", "contexts/arm_rgb", "contexts/elevation"} <= differ
    assert not {"contexts/azimuth", "contexts/goal", "contexts/cylinder", "contexts/initial_qpos"} & differ
    assert not demos["contexts/distractor_visible"].any()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("push", "--vary", "wings"), "wings"),
        (("push", "--vary", "azimuth,,goal"), "--vary ''"),
        (("sweep", "--vary", "distractors"), "sweep"),
        (("reach", "--contexts", "fixed", "--vary", "azimuth"), "narrow"),
    ],
)
@pytest.mark.parametrize("stage", ["train-expert", "collect-demos"])
def test_what_cannot_vary_is_said_before_anything_is_done(tmp_path, monkeypatch, capsys, stage, words, named):
    monkeypatch.chdir(tmp_path)
    assert main([stage, *words, "--preset", "toy", "--out", "new/x.h5"]) == 2
    message = capsys.readouterr().err.strip()
    assert named in message
    assert "--vary" in message
    assert len(message.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_the_learners_context_varies_as_the_demonstrations_unless_told_otherwise(ifo):
    expert = ifo("train-expert", "push")
    translator = ifo("train-translator", ifo("collect-demos", "push", "--expert", expert, "--vary", "azimuth,goal"))
    for words, contexts, vary in (
        ((), "narrow", "azimuth,goal"),
        (("--contexts", "fixed"), "fixed", ""),
        (("--vary", "azimuth"), "narrow", "azimuth"),
    ):
        made = read_artifact(ifo("translate", translator, "--context-seed", 3, *words), "translation")
        assert (made.config["contexts"], made.config["vary"]) == (contexts, vary)
        assert (made["contexts/goal"][0] == CANONICAL_GOAL).all() == ("goal" not in vary)


def test_a_file_does_not_decide_what_code_runs(tmp_path, monkeypatch, capsys):
    """The task that a file names is code; without the user's leave it is not imported."""
    (tmp_path / "stranger.py").write_text("raise SystemExit('the stranger ran')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    arrays = {"frames": np.zeros((12, 25, 48, 48, 3), np.uint8), "final_distance": np.zeros(12)}
    config = {"task": "stranger:Task", "contexts": "paper", "preset": "toy"}
    write_artifact("s.demos.h5", "demos", arrays, config=config, seed=0, command="ifo", environment={})
    assert main(["train-translator", "s.demos.h5", "--steps", "1"]) == 0
    translator = capsys.readouterr().out.strip()
    assert main(["translate", translator]) == 2
    message = capsys.readouterr().err.strip()
    assert "IFO_TASKS" in message
    assert len(message.splitlines()) == 1
