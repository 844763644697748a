"""What `ifo import-demos` prints and refuses."""

from __future__ import annotations

import json

import pytest

from tests.stages.videos import number_in, write_video


@pytest.fixture
def video(tmp_path):
    return write_video(tmp_path / "take.mp4", count=5)


def test_prints_the_artifacts_path_alone(run_ifo, video, tmp_path, monkeypatch):
    from artifacts import read_artifact

    monkeypatch.chdir(tmp_path)
    assert run_ifo("import-demos", video, "--frames", 5, "-q") == (0, "runs/imported.demos.h5\n", "")
    demos = read_artifact("runs/imported.demos.h5", "demos")
    assert [number_in(frame) for frame in demos["frames"][0]] == [0, 1, 2, 3, 4]
    assert (demos.config["preset"], demos.config["task"], demos.manifest.seed) == ("quick", "", 0)
    assert demos.manifest.command == f"ifo import-demos {video} --frames 5 -q"
    assert "contexts" not in demos.config and not demos.manifest.parents


def test_reads_paths_from_standard_input_and_names_what_the_robot_is_to_do(run_ifo, video, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ("import-demos", "--task", "reach", "--preset", "toy", "--json")
    code, out, _ = run_ifo(*words, stdin=f"{video}\n")
    printed = json.loads(out)
    assert code == 0 and out.count("\n") == 1
    assert (printed["path"], printed["kind"]) == ("runs/imported-reach-toy.demos.h5", "demos")
    assert (printed["demos"], printed["skipped"], printed["frames"]) == (1, [], 25)


def test_preview_prints_the_pictures_path(run_ifo, video, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_ifo("import-demos", video, "--preview", "-q") == (0, "runs/imported.demos.preview.png\n", "")


def test_inspect_shows_an_imported_artifact(run_ifo, video, tmp_path):
    out = tmp_path / "x.demos.h5"
    copies = [write_video(tmp_path / f"take{k}.mp4", count=5 + k) for k in range(10)]
    assert run_ifo("import-demos", *copies, "--out", out)[0] == 0
    code, shown, _ = run_ifo("inspect", out)
    assert code == 0 and "take0.mp4" in shown and "9 more (--json shows all)" in shown and "10x25" in shown


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--crop 1,2,3", ["--crop", "X,Y,W,H"]),
        ("--crop 1,2,3,-4", ["--crop", "X,Y,W,H"]),
        ("--crop 0,0,9,9 --crop-file x.csv", ["--crop and --crop-file"]),
        ("--size 50x48", ["--size", "multiples of 4"]),
        ("--size 4800x4800", ["--size", "from 16 to 512"]),
        ("--size big", ["--size", "48x48"]),
        ("--frames 1", ["--frames 1", "2 to 1000"]),
        ("--start -1", ["--start -1", "0 or more"]),
        ("--end nan", ["--end", "finite"]),
        ("--start 3 --end 2", ["--end 2", "--start"]),
        ("--end 2 --fps 3", ["--end and --fps"]),
        ("--task raech", ["raech", "did you mean reach"]),
        ("--preset big", ["--preset", "toy", "quick", "paper"]),
        ("--out x.mp4", ["--out", ".h5"]),
        ("--fsp 3", ["--fsp", "--fps"]),
    ],
)
def test_usage_errors_are_one_line(run_ifo, video, tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    code, out, err = run_ifo("import-demos", video, *words.split())
    assert (code, out) == (2, "") and err.startswith("ifo: ") and err.count("\n") == 1
    assert all(part in err for part in expected)
    assert not (tmp_path / "runs").exists()


def test_no_input_at_all(run_ifo):
    code, out, err = run_ifo("import-demos", terminal=True)
    assert (code, out) == (2, "") and "videos" in err and err.count("\n") == 1
