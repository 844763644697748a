"""A person is filmed, the footage is imported, and an arm of seven joints learns from it by guided policy search."""

from __future__ import annotations

import json

import numpy as np
import pytest

from artifacts import PlatformError, read_artifact, read_mp4
from ifo_cli.main import main

pytestmark = pytest.mark.gl
TOY = ("--preset", "toy", "--workers", 1)


@pytest.fixture
def ifo(tmp_path, monkeypatch, capsys):
    """A function that runs one command in this process; returns exit code, standard output and standard error."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> tuple[int, str, str]:
        code = main([*map(str, words)])
        captured = capsys.readouterr()
        return code, captured.out.strip(), captured.err

    return run


@pytest.mark.parametrize("reward", ["translation", pytest.param("joints", marks=pytest.mark.slow)])
def test_from_footage_to_a_policy(ifo, tmp_path, reward):
    code, filmed, _ = ifo("collect-demos", "push-real", "-n", 12, "--videos", "footage", "--crf", 28, *TOY)
    assert code == 0 and not list((tmp_path / "runs").glob("*.expert.h5"))
    footage = sorted((tmp_path / "footage").iterdir())
    assert len(footage) == 12
    assert read_mp4(footage[0]).shape == (25, 240, 240, 3)
    code, imported, _ = ifo("import-demos", "footage", "--task", "push-real", "--preset", "toy")
    assert code == 0
    frames, seen = (read_artifact(path, "demos")["frames"].astype(float) for path in (filmed, imported))
    assert frames.shape == seen.shape
    assert 10 * np.log10(255**2 / np.square(frames - seen).mean()) > 36  # One frame off: 27.
    code, path, _ = ifo("train-translator", imported, "--steps", 2, "--held-out", 2, *TOY)
    assert code == 0
    code, path, said = ifo("translate", path, "-n", 2, *TOY)
    assert code == 0 and "Kendall's tau" in said  # The person can be asked what they would do here.
    code, path, said = ifo("learn-policy", path, "--learner", "gps", "--reward", reward, *TOY)
    assert code == 0, said
    code, figures, _ = ifo("evaluate", path, "--episodes", 2, "--json", *TOY)
    assert code == 0
    assert 0 <= json.loads(figures)["normalised_distance"] < 3


def test_footage_replaces_nothing_and_lies_apart(ifo, tmp_path):
    (tmp_path / "footage").mkdir()
    for words, complaint in (
        (("--videos", "footage"), "--videos footage: already exists"),
        (("--videos", "runs"), "would be written into it"),
        (("--crf", 10), "--crf 10 has no effect without --videos: give --videos as well"),
    ):
        code, out, said = ifo("collect-demos", "push-real", "-n", 4, *words, *TOY)
        assert (code, out) == (2, "") and said.count("\n") == 1 and complaint in said
    assert not (tmp_path / "runs").exists()


def test_footage_appears_with_its_artifact_or_not_at_all(ifo, tmp_path, monkeypatch):
    def fail(*_):
        raise PlatformError("no room")

    monkeypatch.setattr("stages.collect_demos.write_overview", fail)
    code, out, _ = ifo("collect-demos", "push-real", "-n", 4, "--videos", "footage", *TOY)
    assert (code, out) == (4, "")
    assert not list(tmp_path.glob("**/*.mp4")) and not list(tmp_path.glob("**/*.h5"))


def test_nobody_else_demonstrates_a_household_task(ifo, tmp_path):
    words = ("--iterations", 1, "--episodes", 4, "--test-contexts", 2, "--test-episodes", 2)
    code, expert, said = ifo("train-expert", "push-real", *words, *TOY)
    assert code == 0 and "push-real has a scripted demonstrator" in said
    code, out, said = ifo("collect-demos", "push-real", "-n", 4, "--expert", expert, *TOY)
    assert (code, out) == (2, "") and "has a scripted demonstrator" in said
