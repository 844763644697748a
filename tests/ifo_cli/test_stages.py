"""What a stage's command passes on, prints and refuses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from artifacts import Interrupted, PlatformError, UsageError
from stages.config.presets import PRESETS

ROOT = Path(__file__).parents[2]
CHAIN = [
    ("train-translator", "demos"),
    ("translate", "translator"),
    ("learn-policy", "translation"),
    ("evaluate", "policy"),
]


@pytest.mark.parametrize(("stage", "kind"), CHAIN)
@pytest.mark.parametrize("piped", [False, True])
def test_prints_one_line_and_inherits(run_ifo, calls, make, stage, kind, piped):
    path = make(kind, preset="toy", seed=7)
    words = [stage] if piped else [stage, path]
    code, out, err = run_ifo(*words, stdin=f"  {path} \n" if piped else "")
    assert (code, out.count("\n")) == (0, 1) and out.strip().endswith("result.h5")
    assert "a library that prints" in err
    [(called, (config, run, given, *_))] = calls
    assert called == stage
    assert config == PRESETS["toy"][stage]
    assert (run.preset, run.seed) == ("toy", 7)
    assert given in (path, [path])
    assert run.command == f"ifo {stage} {path}"


def test_json_is_one_object_of_plain_values(run_ifo, calls, make):
    code, out, _ = run_ifo("translate", make("translator"), "--json")
    assert code == 0 and out.count("\n") == 1
    printed = json.loads(out)
    assert printed.pop("path").endswith("result.h5")
    assert printed == {"kind": "translation", "score": 0.5, "rates": [0, 1], "bad": None, "frames": 3}


def test_options_override_the_preset(run_ifo, calls):
    words = "collect-demos reach --preset paper --n 9 --keep-failures --contexts fixed --seed 3 --workers 1"
    assert run_ifo(*words.split())[0] == 0
    [(_, (task, config, run, expert))] = calls
    assert (task, expert) == ("reach", None)
    assert (config.n, config.keep_failures, config.contexts) == (9, True, "fixed")
    assert (run.preset, run.seed, run.workers, run.command) == ("paper", 3, 1, f"ifo {words}")


def test_without_parents_the_preset_is_quick(run_ifo, calls):
    assert run_ifo("train-expert", "reach")[0] == 0
    [(_, (_, config, run))] = calls
    assert config == PRESETS["quick"]["train-expert"] and (run.preset, run.seed) == ("quick", 0)


def test_given_preset_and_seed_win_over_the_parents(run_ifo, calls, make):
    run_ifo("translate", make("translator"), "--preset", "paper", "--seed", "0")
    assert (calls[0][1][1].preset, calls[0][1][1].seed) == ("paper", 0)


def test_repeated_option(run_ifo, calls, make):
    path = make("demos")
    assert run_ifo("train-translator", path, "--without", "rec", "--without", "align", "--no-amp")[0] == 0
    config = calls[0][1][0]
    assert (config.without, config.amp) == (("rec", "align"), False)
    assert all(type(loss) is str for loss in config.without)


def test_a_learner_brings_its_own_defaults_and_what_is_given_wins(run_ifo, calls, make):
    path = make("translation", preset="quick")
    assert run_ifo("learn-policy", path, "--learner", "gps", "--kl", "0.3")[0] == 0
    config = calls[0][1][0]
    assert (config.learner, config.episodes, config.kl) == ("gps", 10, 0.3)


@pytest.mark.parametrize(("preset", "steps"), [("quick", 5000), ("paper", 63_000)])
def test_the_network_for_real_images_brings_its_own_defaults(run_ifo, calls, make, preset, steps):
    words = ["train-translator", make("demos", preset=preset), "--arch", "real"]
    assert run_ifo(*words)[0] == 0 and run_ifo(*words, "--lambda-align", "0.05", "--augment")[0] == 0
    own, given = (config for _, (config, *_) in calls)
    assert (own.arch, own.steps, own.lambda_align, own.augment) == ("real", steps, 0.2, False)
    assert (given.lambda_align, given.augment) == (0.05, True)


def test_expert_is_a_parent(run_ifo, calls, make):
    path = make("expert", preset="toy", seed=5)
    assert run_ifo("collect-demos", "reach", "--expert", path)[0] == 0
    _, config, run, expert = calls[0][1]
    assert expert == path and (run.preset, run.seed) == ("toy", 5) and config == PRESETS["toy"]["collect-demos"]


def test_evaluate_takes_several(run_ifo, calls, make):
    first, second = make("policy", "a"), make("policy", "b", seed=8)
    assert run_ifo("evaluate", stdin=f"{first}\n\n{second}\n")[0] == 0
    assert calls[0][1][2] == [first, second] and calls[0][1][1].seed == 7


def test_json_upstream_is_understood(run_ifo, calls, make):
    path = make("demos")
    assert run_ifo("train-translator", stdin=json.dumps({"path": str(path), "kind": "demos"}) + "\n")[0] == 0
    assert calls[0][1][2] == path


def test_out_folder_is_made(run_ifo, calls, tmp_path):
    out = tmp_path / "new" / "deep" / "x.expert.h5"
    assert run_ifo("train-expert", "reach", "--out", out)[0] == 0
    assert out.parent.is_dir() and calls[0][1][2].out == out


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("collect-demos raech", ["raech", "did you mean reach", "expected one of reach"]),
        ("collect-demos", ["task"]),
        ("train-expert reach --learner gps", ["--learner", "gps", "trpo"]),
        ("collect-demos reach --n 1", ["--n", "2"]),
        ("collect-demos reach --n many", ["--n", "integer"]),
        ("collect-demos reach --contexts wide", ["--contexts", "wide", "paper", "narrow", "fixed"]),
        ("collect-demos reach --preset big", ["--preset", "toy", "quick", "paper"]),
        ("collect-demos reach --seed -1", ["--seed", "0"]),
        ("collect-demos reach --out x.txt", ["--out", "x.txt", ".h5"]),
        ("collect-demos reach --out x.checkpoint.h5", ["--out", ".h5"]),
        ("train-translator x --without z", ["--without", "trans", "rec", "align"]),
        ("train-translator x --learning-rate inf", ["--learning-rate", "finite"]),
        ("train-translator x --learning-rate nan", ["--learning-rate"]),
        ("train-translator x --stesp 3", ["--stesp", "--steps"]),
        ("collect-demos reach --resume", ["--resume"]),
        ("translat", ["translat"]),
    ],
)
def test_usage_errors_are_one_line(run_ifo, calls, words, expected):
    code, out, err = run_ifo(*words.split())
    assert (code, out, calls) == (2, "", [])
    assert err.startswith("ifo: ") and err.count("\n") == 1
    for part in expected:
        assert part in err


def test_terminal_without_argument_is_usage(run_ifo, calls):
    code, out, err = run_ifo("train-translator", terminal=True)
    assert (code, out) == (2, "") and "demos" in err and err.count("\n") == 1


def test_empty_pipe_says_that_the_stage_before_failed(run_ifo, calls):
    code, out, err = run_ifo("translate", stdin="\n")
    assert (code, out) == (3, "")
    assert err.startswith(
        "ifo: no artifact path on standard input: the previous stage failed; otherwise, name the file"
    )


@pytest.mark.parametrize(("stdin", "code"), [("a\nb\n", 2), (b"\x89HDF\r\n\x1a\n\0\0", 3)])
def test_bad_pipes(run_ifo, calls, stdin, code):
    assert run_ifo("translate", stdin=stdin)[0] == code
    assert calls == []


def test_wrong_and_missing_files(run_ifo, calls, make, tmp_path):
    for path in (make("demos"), tmp_path / "gone.translator.h5"):
        code, out, err = run_ifo("translate", path)
        assert (code, out, calls) == (3, "", [])
        assert err.count("\n") == 1 and str(path) in err and "ifo train-translator" in err


def test_out_must_not_replace_the_input(run_ifo, calls, make):
    path = make("translator")
    code, _, err = run_ifo("translate", path, "--out", path)
    assert (code, calls) == (2, []) and "--out" in err


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (PlatformError("no GL"), 4, "ifo: no GL\n"),
        (Interrupted("stopped; continue with --resume"), 130, "ifo: stopped; continue with --resume\n"),
        (KeyboardInterrupt(), 130, "ifo: interrupted\n"),
    ],
)
def test_errors_of_stages(run_ifo, calls, monkeypatch, error, code, line):
    def fail(*_):
        raise error

    monkeypatch.setattr(sys.modules["stages.train_expert"], "train_expert", fail)
    assert run_ifo("train-expert", "reach") == (code, "", line)


def test_what_a_stage_left_before_it_refused_stays(run_ifo, calls, monkeypatch, tmp_path):
    def fail(_, __, run):
        (run.out.parent / "curve").write_text("numbers that diverged")
        raise UsageError("no finite numbers")

    monkeypatch.setattr(sys.modules["stages.train_expert"], "train_expert", fail)
    out = tmp_path / "new" / "x.expert.h5"
    assert run_ifo("train-expert", "reach", "--out", out) == (2, "", "ifo: no finite numbers\n")
    assert [path.name for path in out.parent.iterdir()] == ["curve"]


def test_a_folder_that_cannot_be_written_is_told_of_before_the_work(run_ifo, calls, monkeypatch, tmp_path):
    monkeypatch.setattr("os.access", lambda path, mode: path != tmp_path)
    code, out, err = run_ifo("train-expert", "reach", "--out", tmp_path / "x.expert.h5")
    assert (code, out) == (4, "") and "x.expert.h5: its folder is not writable" in err and not calls


def test_a_bug_shows_its_traceback(run_ifo, calls, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("oops")

    monkeypatch.setattr(sys.modules["stages.train_expert"], "train_expert", fail)
    code, out, err = run_ifo("train-expert", "reach")
    assert (code, out) == (1, "")
    assert "Traceback" in err and "oops" in err and "report" in err.splitlines()[-1]


@pytest.mark.parametrize("words", ["inspect", "verify", "--help"])
def test_a_reader_that_leaves_is_no_error(make, words):
    path = make("demos")
    reading, writing = os.pipe()
    os.close(reading)
    arguments = [words] if words == "--help" else [words, str(path)]
    done = subprocess.run(
        [sys.executable, "-m", "ifo_cli.main", *arguments],
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")
