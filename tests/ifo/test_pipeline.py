"""The stages as Python functions: they do what the commands do."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import ifo
from ifo import pipeline
from stages.config.commands import COMMANDS
from tests.ifo.make_stub import STUB, stub

ROOT = Path(__file__).parents[2]


@pytest.mark.gl
def test_the_quickstart_runs(tmp_path):
    """It has no `if __name__ == '__main__'`, though several processes render."""
    script = ROOT / "examples/quickstart.py"
    done = subprocess.run(
        [sys.executable, script, "--preset", "toy"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    translator = ifo.read_artifact(tmp_path / "runs/reach-toy.translator.h5")
    assert translator.manifest.command == "ifo train-translator runs/reach-toy.demos.h5 --workers=2"
    evaluation = ifo.read_artifact(tmp_path / "runs/reach-toy-c3.evaluation.h5", "evaluation")
    distance = evaluation["summary/normalised_distance_stochastic"]
    assert f"normalized final distance: {distance:.2f}" in done.stdout


def test_errors_are_those_of_the_command(tmp_path):
    with pytest.raises(ifo.ArtifactError, match="no such file"):
        ifo.translate(tmp_path / "x.translator.h5")
    with pytest.raises(ifo.UsageError, match="learner"):
        ifo.learn_policy(tmp_path / "x.translation.h5", learner="guess")
    with pytest.raises(ifo.UsageError, match="no input"):
        ifo.evaluate([])
    with pytest.raises(TypeError, match=r"translate\(\) has no option 'context_sed'"):
        ifo.translate("x.translator.h5", context_sed=3)


def test_an_option_that_is_none_is_not_given():
    assert pipeline._words("translate", {"n": None, "split": "held-out"}) == ["--split=held-out"]


def test_flags_and_lists_are_given_as_on_the_command_line():
    options = {"augment": True, "amp": False, "resume": False, "without": ("rec", "align"), "base": Path("a b.h5")}
    words = ["--augment", "--no-amp", "--without=rec", "--without=align", "--from=a b.h5"]
    assert pipeline._words("train-translator", options) == words


def test_a_path_may_look_like_an_option(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ifo.ArtifactError, match=r"-x\.h5: no such file"):
        ifo.translate("-x.h5")


def test_the_stub_has_the_options_of_the_commands():
    """If it fails: `python -m tests.ifo.make_stub`, and format the file."""
    assert ast.dump(ast.parse(STUB.read_text(encoding="utf-8"))) == ast.dump(ast.parse(stub()))


def test_every_stage_is_a_function():
    others = {"check-task", "export-demos", "report", "reproduce", "view"}
    named = {function.__name__.replace("_", "-") for function in pipeline.STAGES}
    assert named == {name for name, command in COMMANDS.items() if "out" in command.names} - others
