"""Nothing finished is replaced silently, by any stage; what a command would make anyway is kept."""

from __future__ import annotations

import shutil

import pytest

from artifacts import read_artifact, verify_artifact
from stages.runtime.outputs import Output

STAGES = {
    "collect-demos": ("reach", "demos"),
    "train-translator": ("demos", "translator"),
    "translate": ("translator", "translation"),
    "learn-policy": ("translation", "policy"),
    "evaluate": ("policy", "evaluation"),
}


def command(toy, stage):
    """The command that made this stage's artifact."""
    reads, _ = STAGES[stage]
    given = ["reach", "--preset", "toy", "--seed", "5"] if stage == "collect-demos" else [toy.artifact(reads)]
    return [stage, *given]


def stamp(path):
    return path.stat().st_mtime_ns, path.read_bytes()


@pytest.mark.parametrize("stage", STAGES)
def test_the_same_command_keeps_what_it_made(toy, ifo, stage):
    path = toy.artifact(STAGES[stage][1])
    before = stamp(path)
    done = ifo(toy.folder, *command(toy, stage), "--json")
    assert done.returncode == 0, done.stderr
    assert f"kept runs/{path.name}" in done.stderr or f"kept {path}" in done.stderr
    assert path.name in done.stdout
    assert stamp(path) == before


@pytest.mark.parametrize(
    ("stage", "options"),
    [
        ("collect-demos", ["-n", "70"]),
        ("train-translator", ["--steps", "31"]),
        ("translate", ["-n", "7"]),
        ("learn-policy", ["--iterations", "4"]),
        ("evaluate", ["--episodes", "9"]),
    ],
)
def test_another_command_of_the_same_name_is_refused(toy, ifo, stage, options):
    path = toy.artifact(STAGES[stage][1])
    before = stamp(path)
    done = ifo(toy.folder, *command(toy, stage), *options)
    assert (done.returncode, done.stdout) == (2, "")
    assert options[0].lstrip("-") in done.stderr
    assert "--overwrite" in done.stderr
    assert stamp(path) == before


class Settled(Exception):
    """Where a stage would write."""


@pytest.mark.parametrize(
    ("stage", "options", "name"),
    [
        ("collect-demos", ["--seed", "1"], "reach-toy-s1.demos.h5"),
        ("train-translator", ["--seed", "3"], "reach-toy-s5-s3.translator.h5"),
        ("train-translator", ["--arch", "real"], "reach-toy-s5-real.translator.h5"),
        ("translate", ["--context-seed", "4"], "reach-toy-s5-c4.translation.h5"),
        ("learn-policy", ["--learner", "ppo"], "reach-toy-s5-c0-ppo.policy.h5"),
        ("learn-policy", ["--learner", "gps"], "reach-toy-s5-c0-gps.policy.h5"),
        ("learn-policy", ["--without", "img"], "reach-toy-s5-c0-without-img.policy.h5"),
        ("learn-policy", ["--negatives", "5"], "reach-toy-s5-c0-negatives5.policy.h5"),
        ("evaluate", ["--seed", "2"], "reach-toy-s5-c0-s2.evaluation.h5"),
    ],
)
def test_runs_that_differ_have_names_of_their_own(toy, ifo, monkeypatch, stage, options, name):
    def settled(output):
        raise Settled(output.path.name)

    monkeypatch.setattr(Output, "kept", settled)
    words = [word for word in command(toy, stage) if "--seed" not in options or word not in ("--seed", "5")]
    done = ifo(toy.folder, *words, *options)
    assert f"Settled: {name}" in done.stderr


def test_equal_content_made_anew_invalidates_nothing(toy, ifo):
    demos, translator = toy.artifact("demos"), toy.artifact("translator")
    before = read_artifact(demos).manifest
    done = ifo(toy.folder, *command(toy, "collect-demos"), "--overwrite")
    assert done.returncode == 0, done.stderr
    after = read_artifact(demos).manifest
    assert after.command != before.command
    assert after.content == before.content
    verify_artifact(translator)
    assert "kept" in ifo(toy.folder, *command(toy, "train-translator")).stderr


def test_footage_that_is_gone_is_told(toy, ifo, tmp_path):
    expert, footage = toy.artifact("expert"), tmp_path / "footage"
    words = ["collect-demos", "reach", "--preset", "toy", "-n", "4", "--expert", expert, "--videos", footage]
    words += ["--out", tmp_path / "f.demos.h5"]
    assert ifo(tmp_path, *words).returncode == 0
    assert "kept" in ifo(tmp_path, *words).stderr
    shutil.rmtree(footage)
    done = ifo(tmp_path, *words)
    assert done.returncode == 2
    assert f"{footage} does not" in done.stderr and "kept" not in done.stderr
