"""Stages killed in the middle: nothing half-written, and --resume ends where an undisturbed run does."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from artifacts import read_artifact, verify_artifact
from ifo_cli.main import main

pytestmark = pytest.mark.gl
ROOT = Path(__file__).resolve().parents[2]


def start(folder, words):
    command = [sys.executable, "-m", "ifo_cli.main", *map(str, words)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Tests that a shell runs in the background inherit an ignored Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def finish(folder, words):
    """Run a stage to its end, in this process, which saves seconds of imports."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([*map(str, words)])
    return code, out.getvalue(), err.getvalue()


def interrupt(folder, words, checkpoint, signal_number):
    """Start a stage and send it a signal once it has written a checkpoint."""
    process = start(folder, words)
    deadline = time.monotonic() + 120
    while not checkpoint.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    assert process.poll() is None, process.communicate()
    process.send_signal(signal_number)
    _, stderr = process.communicate(timeout=60)
    return process.returncode, stderr


def assert_same_weights(one, other):
    first, second = read_artifact(one), read_artifact(other)
    names = [name for name in first.names() if name.startswith(("weights/", "curve/")) and name != "curve/seconds"]
    assert names
    for name in names:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A folder with toy demos and a toy translation."""
    folder = tmp_path_factory.mktemp("inputs")
    for words in (
        ("collect-demos", "reach", "--preset", "toy"),
        ("train-translator", "runs/reach-toy.demos.h5", "--steps", 4),
        ("translate", "runs/reach-toy.translator.h5"),
    ):
        code, _, stderr = finish(folder, words)
        assert code == 0, stderr
    return folder


CASES = {
    "train-expert": (
        ("train-expert", "reach", "--preset", "toy", "--iterations", 6, "--checkpoint-every", 2),
        "expert",
    ),
    "train-translator": (
        ("train-translator", "runs/reach-toy.demos.h5", "--steps", 30, "--checkpoint-every", 10),
        "translator",
    ),
    "train-translator real": (
        (
            *("train-translator", "runs/reach-toy.demos.h5", "--steps", 30, "--checkpoint-every", 10),
            *("--arch", "real", "--augment"),
        ),
        "translator",
    ),
    "learn-policy": (
        (
            *("learn-policy", "runs/reach-toy-c0.translation.h5", "--iterations", 6, "--checkpoint-every", 2),
            *("--negatives", 3),
        ),
        "policy",
    ),
}


@pytest.mark.parametrize(
    "stage", [pytest.param(case, marks=pytest.mark.slow if case.endswith(" real") else ()) for case in CASES]
)
def test_sigkill_then_resume_gives_the_undisturbed_result(stage, inputs, tmp_path):
    words, kind = CASES[stage]
    whole, killed = tmp_path / f"whole.{kind}.h5", tmp_path / f"killed.{kind}.h5"
    code, _, stderr = finish(inputs, (*words, "--out", whole))
    assert code == 0, stderr
    checkpoint = tmp_path / f"killed.{kind}.checkpoint.h5"
    code, _ = interrupt(inputs, (*words, "--out", killed), checkpoint, signal.SIGKILL)
    assert code == -signal.SIGKILL
    assert not killed.exists(), "an unfinished stage leaves no artifact"
    verify_artifact(checkpoint)
    code, stdout, stderr = finish(inputs, (*words, "--out", killed, "--resume"))
    assert code == 0, stderr
    assert "resuming" in stderr
    assert stdout == f"{killed}\n"
    assert not checkpoint.exists()
    assert_same_weights(whole, killed)


def test_control_c_keeps_the_checkpoint_and_says_how_to_go_on(inputs, tmp_path):
    words, kind = CASES["train-translator"]
    out, checkpoint = tmp_path / f"x.{kind}.h5", tmp_path / f"x.{kind}.checkpoint.h5"
    code, stderr = interrupt(inputs, (*words, "--out", out), checkpoint, signal.SIGINT)
    assert code == 130, stderr
    assert not out.exists()
    assert "--resume" in stderr.splitlines()[-1]
    verify_artifact(checkpoint)


def test_resume_refuses_other_options_and_keeps_the_checkpoint(inputs, tmp_path):
    words, kind = CASES["train-translator"]
    out, checkpoint = tmp_path / f"x.{kind}.h5", tmp_path / f"x.{kind}.checkpoint.h5"
    interrupt(inputs, (*words, "--out", out), checkpoint, signal.SIGKILL)
    kept = checkpoint.read_bytes()
    code, stdout, stderr = finish(inputs, (*words, "--out", out, "--learning-rate", 0.5, "--resume"))
    assert code == 2
    assert stdout == ""
    assert "learning_rate" in stderr
    assert checkpoint.read_bytes() == kept


def test_resume_refuses_an_input_that_changed(inputs, tmp_path):
    demos, out = tmp_path / "x.demos.h5", tmp_path / "x.translator.h5"
    checkpoint = tmp_path / "x.translator.checkpoint.h5"
    collect = ("collect-demos", "reach", "--preset", "toy", "--expert", "runs/reach-toy.expert.h5", "--out", demos)
    train = ("train-translator", demos, "--seed", 0, "--steps", 60, "--checkpoint-every", 20, "--out", out)
    assert finish(inputs, (*collect, "--seed", 0))[0] == 0
    interrupt(inputs, train, checkpoint, signal.SIGKILL)
    assert finish(inputs, (*collect, "--seed", 1, "--overwrite"))[0] == 0
    code, stdout, stderr = finish(inputs, (*train, "--resume"))
    assert code == 2
    assert stdout == ""
    assert "input file" in stderr
    assert not out.exists()


@pytest.mark.parametrize("delay", [0.5, 2.0, 3.5])
def test_killing_collect_demos_leaves_the_old_demos_or_new_ones(delay, inputs, tmp_path):
    out = tmp_path / "x.demos.h5"
    old = (inputs / "runs" / "reach-toy.demos.h5").read_bytes()
    out.write_bytes(old)
    words = ("collect-demos", "reach", "--preset", "toy", "--seed", 3, "--n", 512)
    expert = next((inputs / "runs").glob("*.expert.h5"))
    process = start(inputs, (*words, "--expert", expert, "--out", out))
    time.sleep(delay)
    process.kill()
    process.communicate(timeout=60)
    frames = read_artifact(out, "demos")["frames"]
    assert len(frames) in (64, 512)
    if len(frames) == 64:
        assert out.read_bytes() == old
