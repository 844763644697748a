"""What `ifo report` prints and refuses."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest

from artifacts import write_artifact
from stages.reporting.intervals import wilson


@pytest.fixture
def evaluation(tmp_path):
    """A function that writes an evaluation of one run."""

    def write(name="x", seed=0):
        names = ("initial_distance", "final_distance", "final_distance_stochastic", "normalised_distance")
        arrays = dict.fromkeys(names, np.full((1, 2), 0.75))
        arrays["normalised_distance_stochastic"] = np.full((1, 2), 0.25)
        run = {"policy": "p", "reward": "oracle", "method": "oracle", "seed": seed, "context_seed": 0}
        config = {
            "task": "reach",
            "success_threshold": 0.5,
            "runs": [{**run, "samples": 10, "learning_minutes": 1.0}],
        }
        path = tmp_path / "runs" / f"{name}.evaluation.h5"
        return write_artifact(path, "evaluation", arrays, config=config, seed=0, command="ifo evaluate")

    return write


def test_prints_the_pages_path_alone(run_ifo, evaluation, tmp_path):
    evaluation()
    page = tmp_path / "new" / "page.html"
    assert run_ifo("report", tmp_path, "--out", page, "--title", "My runs", "--quiet") == (0, f"{page}\n", "")
    assert "<h1>My runs</h1>" in page.read_text()
    assert f"ifo report {tmp_path} --out" in page.read_text()


def test_is_written_into_runs_by_default(run_ifo, evaluation, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, _ = run_ifo("report", stdin=f"{evaluation()}\n")
    assert (code, out) == (0, "runs/report.html\n") and (tmp_path / "runs" / "report.html").is_file()


def test_json(run_ifo, evaluation, tmp_path):
    code, out, _ = run_ifo("report", evaluation(), "--out", tmp_path / "page.html", "--json")
    printed = json.loads(out)
    assert code == 0 and out.count("\n") == 1
    assert (printed["kind"], printed["evaluations"], printed["duplicates"]) == ("report", 1, 0)
    low, high = wilson(1, 1)
    assert printed["methods"] == [
        {
            "task": "reach",
            "method": "oracle",
            "runs": 1,
            "succeeded": 1,
            "success_paper": 1.0,
            "success_paper_interval": [low, high],
            "success_deterministic": 0.0,
            "normalised_distance": 0.25,
            "normalised_distance_interval": [0.25, 0.25],
            "samples": 10.0,
            "learning_minutes": 1.0,
            "translator_minutes": None,
            "papers_own_success": 0.9,
        }
    ]


def test_files_named_twice_count_once_and_runs_twice_there_are_said(run_ifo, evaluation, tmp_path):
    first, out = evaluation("first"), tmp_path / "page.html"
    code, _, err = run_ifo("report", first, first.parent, "--out", out)
    assert code == 0 and "counted once" not in err and "Runs: 1, of evaluation artifacts: 1" in out.read_text()
    link = tmp_path / "link.evaluation.h5"
    link.symlink_to(first)
    code, _, err = run_ifo("report", first, link, "--out", out)
    assert code == 0 and "counted once" not in err
    second = evaluation("second")
    code, _, err = run_ifo("report", first, second, "--out", out)
    assert code == 0 and "counted once" in err and str(first) in err and str(second) in err
    assert "Runs: 1, of evaluation artifacts: 2" in out.read_text()


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("empty-folder", ["contains no evaluation", "ifo evaluate"]),
        ("missing", ["no such file", "ifo evaluate"]),
        ("wrong-kind", ["is a demos artifact, expected an evaluation"]),
        ("truncated", ["truncated or damaged"]),
        ("corrupt", ["damaged"]),
        ("too-little-in-it", ["task: field required"]),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(run_ifo, evaluation, make, tmp_path, fault, words):
    good = evaluation("good")
    bad = evaluation("bad", seed=1)
    data = bad.read_bytes()
    if fault == "empty-folder":
        bad = tmp_path / "empty"
        bad.mkdir()
    elif fault == "missing":
        bad.unlink()
    elif fault == "wrong-kind":
        bad = make("demos")
    elif fault == "truncated":
        bad.write_bytes(data[: len(data) // 2])
    elif fault == "corrupt":
        number = np.full(2, 0.25).tobytes()
        place = data.index(number)
        bad.write_bytes(data[:place] + b"\1" + data[place + 1 :])
    else:
        bad = make("evaluation")
    out = tmp_path / "out" / "page.html"
    code, printed, err = run_ifo("report", good, bad, "--out", out)
    assert (code, printed) == (3, "") and err.count("\n") == 1
    assert str(bad) in err and any(word in err for word in words)
    assert not out.parent.exists()


@pytest.mark.parametrize(("out", "words"), [("x.pdf", [".html"]), (".", ["."]), ("folder.html", ["is a folder"])])
def test_bad_out(run_ifo, evaluation, tmp_path, monkeypatch, out, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.html").mkdir()
    code, printed, err = run_ifo("report", evaluation(), "--out", out)
    assert (code, printed) == (2, "") and err.count("\n") == 1
    assert all(word in err for word in ["--out", *words])


def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(run_ifo, evaluation, tmp_path):
    os.mkfifo(tmp_path / "page.md")
    code, out, err = run_ifo("report", evaluation(), "--out", tmp_path / "page.html")
    assert (code, out) == (2, "") and "which `ifo report` did not write" in err and err.count("\n") == 1


def test_a_pipe_in_the_place_of_a_video_is_not_waited_for(run_ifo, evaluation, tmp_path):
    path = evaluation()
    path.with_suffix(".mp4").unlink(missing_ok=True)
    os.mkfifo(path.with_suffix(".mp4"))
    code, _, _ = run_ifo("report", path, "--out", tmp_path / "page.html", "--quiet")
    assert code == 0 and "Missing videos" in (tmp_path / "page.html").read_text()


def test_a_place_that_cannot_be_written_is_one_line(run_ifo, evaluation, tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    for folder in ("x" * 300, "loop", "x/" * 3000):
        code, out, err = run_ifo("report", evaluation(), "--out", tmp_path / folder / "page.html", "--quiet")
        assert (code, out) == (4, "") and "cannot be written" in err and err.count("\n") == 1
