"""What `ifo export-demos` prints and refuses."""

from __future__ import annotations

import json
import os

import pytest


def test_prints_the_path_alone_and_import_demos_takes_it(run_ifo, make, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = make("demos").relative_to(tmp_path)
    assert run_ifo("export-demos", path, "--format", "robomimic", "-q") == (0, "x.robomimic.hdf5\n", "")
    assert run_ifo("export-demos", "--format", "lerobot", "--out", "new/set", "-q", stdin=f"{path}\n")[1] == "new/set\n"
    code, out, err = run_ifo("import-demos", "--frames", 3, stdin="new/set\n")
    assert code == 3 and out == "" and "8x8 pixels: expected 16" in err  # as small as the test's


def test_where_it_came_from_goes_along(run_ifo, make, tmp_path):
    from artifacts import sha256_of

    path = make("demos")
    assert run_ifo("export-demos", "--format", "lerobot", "--fps", 4, stdin=f"{path}\n")[0] == 0
    told = json.loads((tmp_path / "x.lerobot/meta/ifo.json").read_text())
    assert (
        told["demos_sha256"] == sha256_of(path) and f"ifo export-demos --format lerobot --fps 4 {path}" in told["from"]
    )
    assert json.loads((tmp_path / "x.lerobot/meta/info.json").read_text())["fps"] == 4


@pytest.mark.parametrize("name", ["lerobot", "robomimic", "minari"])
def test_words_in_bytes_of_old(run_ifo, make, name):
    assert run_ifo("export-demos", make("demos"), "--format", name, "--task", os.fsdecode(b"K\xfcche"))[0] == 0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("", ["--format"]),
        ("--format hdf5", ["--format", "lerobot", "robomimic", "minari"]),
        ("--format minari --video", ["--video", "lerobot"]),
        ("--format lerobot --crf 9", ["--crf 9", "--video"]),
        ("--format lerobot --video --crf 99", ["--crf 99", "1 to 51"]),
        ("--format lerobot --fps -1", ["--fps -1", "0 to 1000"]),
        ("--format lerobot --fps 2.5", ["--fps"]),
        ("--format minari --camera top", ["--camera top", "--format lerobot or robomimic"]),
        ("--format lerobot --camera a/b", ["--camera", "for example front"]),
        ("--format lerobot --out set.h5", ["--out set.h5", "folder"]),
        ("--format robomimic --out set", ["--out set", ".hdf5"]),
        ("--format lerobot --lossles", ["--lossles"]),
    ],
)
def test_usage_errors_are_one_line(run_ifo, make, tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    path = make("demos")
    code, out, err = run_ifo("export-demos", path, *words.split())
    assert (code, out) == (2, "") and err.startswith("ifo: ") and err.count("\n") == 1
    assert all(part in err for part in expected)
    assert list(tmp_path.iterdir()) == [path]


def test_a_name_that_is_not_utf8(run_ifo, make, tmp_path):
    path, name = make("demos"), os.fsdecode(b"K\xfcche")
    for format_, code in (("lerobot", 4), ("minari", 0)):
        found, _, err = run_ifo("export-demos", path, "--format", format_, "--out", tmp_path / name, "--quiet")
        assert found == code and err.count("\n") == bool(code) and (code == 0 or "UTF-8" in err)
        assert (tmp_path / name).exists() == (code == 0)


def test_wrong_and_missing_files(run_ifo, make, tmp_path):
    for path in (make("translation"), tmp_path / "gone.demos.h5"):
        code, out, err = run_ifo("export-demos", path, "--format", "minari")
        assert (code, out) == (3, "") and err.count("\n") == 1 and str(path) in err
    assert run_ifo("export-demos", "--format", "minari", terminal=True)[0] == 2
    assert run_ifo("export-demos", "--format", "minari", stdin="\n")[0] == 3
