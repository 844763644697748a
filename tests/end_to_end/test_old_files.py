"""Stages go on from files that schema 1 wrote."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from artifacts import read_artifact, verify_artifact
from ifo_cli.main import main
from tests.artifacts.samples import OLD_CHECKPOINT, OLD_FILES

pytestmark = pytest.mark.gl


def test_a_checkpoint_of_schema_1_is_resumed(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("IFO_TASKS", "tests.fixtures.small_reach:SmallReach")
    for path in (*OLD_FILES.values(), OLD_CHECKPOINT):
        shutil.copy(path, tmp_path)
    out = tmp_path / OLD_FILES["policy"].name
    out.unlink()
    words = ["--iterations", "8", "--episodes", "4", "--hidden", "8", "--checkpoint-every", "4", "--resume"]
    translation = tmp_path / OLD_FILES["translation"].name
    assert main(["learn-policy", str(translation), "--out", str(out), *words]) == 0, capsys.readouterr().err
    captured = capsys.readouterr()
    assert f"resuming {out.name} from {OLD_CHECKPOINT.name}" in captured.err
    resumed, before = read_artifact(out, "policy"), read_artifact(OLD_FILES["policy"], "policy")
    curve = resumed["curve/seconds"]
    assert len(curve) == 8
    np.testing.assert_array_equal(curve[:4], before["curve/seconds"][:4])
    assert verify_artifact(out).parents == 1
    assert not (tmp_path / OLD_CHECKPOINT.name).exists()
    assert main(["evaluate", str(out), "--episodes", "2", "--overwrite"]) == 0, capsys.readouterr().err


def test_measured_times_and_names_are_no_part_of_the_content(tmp_path, monkeypatch, capsys):
    """Two runs of one command with one seed have the same content, whatever they took and wherever they wrote."""
    monkeypatch.setenv("IFO_TASKS", "tests.fixtures.small_reach:SmallReach")
    demos, policy = tmp_path / OLD_FILES["demos"].name, tmp_path / OLD_FILES["policy"].name
    for path in OLD_FILES.values():
        shutil.copy(path, tmp_path)
    commands = {
        "translator": ["train-translator", str(demos), "--arch", "real", "--steps", "2", "--videos", "2"],
        "evaluation": ["evaluate", str(policy), "--episodes", "2"],
    }
    for kind, words in commands.items():
        made = []
        for name in ("first", "second"):
            assert main([*words, "--out", str(tmp_path / name / f"{name}.{kind}.h5")]) == 0, capsys.readouterr().err
            made.append(read_artifact(tmp_path / name / f"{name}.{kind}.h5", kind))
        first, second = made
        assert first.content == second.content
        if kind == "translator":
            assert (first["curve/seconds"] != second["curve/seconds"]).any()
