"""Every stage answers a bad file with one line and exit code 3, and writes nothing."""

from __future__ import annotations

import io
import os
import shutil
import sys

import h5py
import numpy as np
import pytest

from artifacts import write_artifact
from ifo_cli.main import main

# Stage, the words before its input, the kind it reads.
STAGES = {
    "collect-demos": (["collect-demos", "reach", "--preset", "toy", "--expert"], "expert"),
    "train-translator": (["train-translator"], "demos"),
    "translate": (["translate"], "translator"),
    "learn-policy": (["learn-policy"], "translation"),
    "evaluate": (["evaluate"], "policy"),
}
ARRAYS = {
    "expert": {"weights/a": np.zeros(3, np.float32)},
    "demos": {"frames": np.zeros((8, 5, 16, 16, 3), np.uint8), "final_distance": np.zeros(8)},
    "translator": {"weights/a": np.zeros(3, np.float32)},
    "translation": {
        "context_frame": np.zeros((16, 16, 3), np.uint8),
        "target_features": np.zeros((5, 4), np.float32),
        "target_images": np.zeros((5, 16, 16, 3), np.float32),
        "contexts/goal": np.zeros((1, 2)),
    },
    "policy": {"weights/a": np.zeros(3, np.float32)},
}
PARENT = {"demos": "expert", "translator": "demos", "translation": "translator", "policy": "translation"}
CONFIG = {"preset": "toy", "task": "reach", "learner": "trpo", "hidden": 64, "observation_size": 7, "action_size": 3}
FAULTS = ("missing", "empty", "truncated", "corrupt", "not-hdf5", "wrong-kind", "newer-schema", "missing-parent")
# The other stages need their input alone, not what it was made from.
NEEDS_PARENT = ("translate", "learn-policy")
CASES = [(s, f) for s in STAGES for f in FAULTS if f != "missing-parent" or s in NEEDS_PARENT]


def write(folder, kind, parents=()):
    return write_artifact(
        folder / f"x.{kind}.h5", kind, ARRAYS[kind], config=CONFIG, seed=0, command="ifo", parents=parents
    )


def spoil(folder, kind, fault):
    """An artifact of `kind` with `fault`."""
    if fault == "wrong-kind":
        return write(folder, "demos" if kind != "demos" else "policy")
    parents = [write(folder, PARENT[kind])] if kind in PARENT else []
    path = write(folder, kind, parents)
    data = path.read_bytes()
    if fault == "missing":
        path.unlink()
    elif fault == "empty":
        path.write_bytes(b"")
    elif fault == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif fault == "not-hdf5":
        path.write_bytes(b"PNG" * 1000)
    elif fault == "corrupt":
        damaged = bytearray(data)
        for k in range(len(data) // 4, len(data), 97):
            damaged[k] ^= 0xFF
        path.write_bytes(bytes(damaged))
    elif fault == "newer-schema":
        with h5py.File(path, "r+") as file:
            file.attrs["schema_version"] = 99
    elif fault == "missing-parent":
        parents[0].unlink()
    return path


@pytest.mark.gl
@pytest.mark.parametrize(("stage", "fault"), CASES)
def test_one_line_exit_code_3_and_nothing_written(stage, fault, tmp_path, monkeypatch, capfd):
    words, kind = STAGES[stage]
    path = spoil(tmp_path, kind, fault)
    out = tmp_path / "out" / "y.any.h5"
    before = {item: item.read_bytes() for item in tmp_path.iterdir() if item.is_file()}
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    capfd.readouterr()
    code = main([*words, str(path), "--out", str(out)])
    captured = capfd.readouterr()
    assert code == 3, captured.err
    assert captured.out == ""
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, captured.err
    assert path.name in lines[0]
    assert not any(out.parent.glob("*")) if out.parent.exists() else True
    assert before == {item: item.read_bytes() for item in tmp_path.iterdir() if item.is_file()}


@pytest.mark.parametrize("stage", ["learn-policy", "translate", "evaluate"])
def test_a_configuration_that_lacks_a_key_is_the_files_fault(stage, tmp_path, monkeypatch, capfd):
    words, kind = STAGES[stage]
    monkeypatch.setitem(globals(), "CONFIG", {"preset": "toy"})
    path = write(tmp_path, kind, [write(tmp_path, PARENT[kind])])
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert main([*words, str(path)]) == 3
    lines = capfd.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert "lacks" in lines[0]


@pytest.mark.parametrize(
    "words",
    [
        ("train-translator", "DEMOS", "--without", "trans", "--without", "rec", "--without", "align"),
        ("train-translator", "DEMOS", "--workers", "100000"),
        ("train-translator", "DEMOS", "--ema", "1.5"),
        ("train-translator", "DEMOS", "--device", "banana"),
    ],
)
def test_options_that_make_no_sense_are_usage_errors(words, tmp_path, monkeypatch, capfd):
    demos = write(tmp_path, "demos")
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert main([str(demos) if word == "DEMOS" else word for word in words]) == 2
    assert len(capfd.readouterr().err.strip().splitlines()) == 1


def test_the_old_artifact_survives_a_stage_that_fails(tmp_path, monkeypatch, capfd):
    old = write(tmp_path, "translator", [write(tmp_path, "demos")])
    kept = tmp_path / "kept.translator.h5"
    shutil.copy(old, kept)
    bad = spoil(tmp_path, "demos", "truncated")
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert main(["train-translator", str(bad), "--out", str(kept)]) == 3
    assert kept.read_bytes() == old.read_bytes()


@pytest.mark.parametrize("stage", STAGES)
def test_a_task_that_does_not_exist_is_the_files_fault(stage, tmp_path, monkeypatch, capfd):
    words, kind = STAGES[stage]
    monkeypatch.setitem(CONFIG, "task", "raech")
    path = write(tmp_path, kind, [write(tmp_path, PARENT[kind])] if kind in PARENT else [])
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert main([*words, str(path), "--out", str(tmp_path / "out.h5")]) == 3
    [line] = capfd.readouterr().err.strip().splitlines()
    assert path.name in line and "raech" in line


@pytest.mark.parametrize("command", ["train-translator", "export-demos", "inspect", "verify", "report"])
def test_a_file_that_is_removed_as_the_command_begins_is_a_missing_input(command, tmp_path, monkeypatch, capfd):
    path = write(tmp_path, "demos")
    stat = os.stat

    def removed_after(*arguments, **options):
        found = stat(*arguments, **options)
        path.unlink(missing_ok=True)
        return found

    monkeypatch.setattr("os.stat", lambda *a, **o: removed_after(*a, **o) if str(a[0]) == str(path) else stat(*a, **o))
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    more = ("--format", "robomimic") if command == "export-demos" else ()
    assert main([command, str(path), *more]) == 3
    assert len(capfd.readouterr().err.strip().splitlines()) == 1
