"""`--show-config` prints what every option resolves to; `--config` reads the same form."""

from __future__ import annotations

import dataclasses
import os
import tomllib

import pytest

from stages.config.presets import PRESETS, defaults
from stages.config.stages import STAGES
from stages.config.toml import STAGES_WITH_TABLES
from stages.reproduction.plan import BLANK, METHODS, OWN

INPUTS = {
    "train-translator": "demos",
    "translate": "translator",
    "learn-policy": "translation",
    "evaluate": "policy",
}
TASKS_NAMED = {"train-expert": ["push"], "collect-demos": ["push-real"], "export-demos": ["--format", "minari"]}


@pytest.fixture
def words_for(make):
    """A function that gives the words of a stage with an input of task and preset."""

    def words(stage, task="push", preset="paper", seed=4):
        if stage in INPUTS:
            return [stage, make(INPUTS[stage], preset=preset, seed=seed, config={"task": task})]
        return [stage, *TASKS_NAMED.get(stage, [])]

    return words


@pytest.mark.parametrize("stage", STAGES_WITH_TABLES)
def test_a_round_trip_changes_nothing(run_ifo, calls, words_for, tmp_path, stage):
    words = words_for(stage)
    code, shown, err = run_ifo(*words, "--show-config")
    assert (code, err, calls) == (0, "", [])
    file = tmp_path / "f.toml"
    file.write_text(shown, encoding="utf-8")
    code, again, err = run_ifo(*words, "--config", file, "--show-config")
    assert (code, err) == (0, "")
    assert tomllib.loads(again) == tomllib.loads(shown) and list(tomllib.loads(shown)) == [stage]
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("stage", "options"),
    [
        ("learn-policy", ["--learner", "gps", "--reward", "joints"]),
        ("learn-policy", ["--learner", "sac", "--reward", "oracle"]),
        ("learn-policy", ["--reward", "gail", "--discriminator-steps", "3"]),
        ("train-translator", ["--arch", "real", "--without", "rec"]),
        ("train-translator", ["--steps", "0"]),
    ],
)
def test_a_whole_file_is_not_refused_for_what_would_have_been_anyway(
    run_ifo, calls, words_for, tmp_path, stage, options
):
    words = words_for(stage, task="sweep-paper", preset="quick")
    assert run_ifo(*words, *options)[0] == 0
    file = tmp_path / "f.toml"
    file.write_text(run_ifo(*words, *options, "--show-config")[1], encoding="utf-8")
    code, _, err = run_ifo(*words, "--config", file)
    assert code == 0, err
    [first, second] = [arguments[0] for _, arguments in calls]
    assert first == second


def test_origins_are_told(run_ifo, words_for, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("[train-translator]\nvideos = 12\nworkers = 2\n", encoding="utf-8")
    words = [*words_for("train-translator", preset="paper"), "--steps", "9", "--config", file]
    _, shown, _ = run_ifo(*words, "--show-config")
    origins = {line.split(" = ")[0]: line.rpartition("  # ")[2] for line in shown.splitlines() if " = " in line}
    assert origins["steps"] == "given" and origins["videos"] == origins["workers"] == str(file)
    assert origins["preset"] == origins["seed"] == "parent" and origins["device"] == "default"
    assert origins["ema"] == "preset paper" and origins["swap_colours"] == "task push"
    assert origins["held_out"] == "default"
    assert "task push" in shown.splitlines()[0]
    _, shown, _ = run_ifo(
        *words_for("learn-policy", task="sweep-paper", preset="quick"), "--show-config", "--learner", "gps"
    )
    origins = {line.split(" = ")[0]: line.rpartition("  # ")[2] for line in shown.splitlines() if " = " in line}
    assert origins["kl"] == "learner gps" and origins["log_std"] == "task sweep-paper with gps"


def test_the_command_line_wins_over_the_file_and_the_file_over_the_parent(run_ifo, calls, words_for, tmp_path):
    file = tmp_path / "all.toml"
    file.write_text(
        '[train-expert]\niterations = 7\n[learn-policy]\nseed = 9\npreset = "toy"\nkl = 0.5\nblur = 3\n'
        '[translate]\nnonsense = "is not looked at"\n',
        encoding="utf-8",
    )
    assert run_ifo(*words_for("learn-policy", seed=4), "--config", file, "--kl", "0.25")[0] == 0
    config, run, _ = calls[0][1]
    assert (config.kl, config.blur, config.episodes) == (0.25, 3.0, PRESETS["toy"]["learn-policy"].episodes)
    assert type(config.blur) is float
    assert (run.preset, run.seed) == ("toy", 9)
    assert run.given == {"kl", "blur"}
    assert run_ifo("evaluate", words_for("evaluate")[1], "--config", file)[0] == 0, "a file without a table for it"
    assert calls[1][1][0] == defaults("paper", "evaluate", "push")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[learn-polcy]\nkl = 1.0\n", ["[learn-polcy]", "learn-policy"]),
        ("[learn-policy]\nblurr = 1.0\n", ["[learn-policy] blurr", "expected blur"]),
        ("[learn-policy]\nblur = 'wide'\n", ["[learn-policy] blur", "expected a number"]),
        ("[learn-policy]\nblur = true\n", ["[learn-policy] blur", "expected a number"]),
        ("[learn-policy]\nblur = 1000\n", ["[learn-policy] blur", "0 to 100"]),
        ("[learn-policy]\nblur = nan\n", ["[learn-policy] blur", "finite"]),
        ("[learn-policy]\nepisodes = 2.5\n", ["[learn-policy] episodes", "a whole number"]),
        ("[learn-policy]\nreward = 'money'\n", ["[learn-policy] reward", "oracle"]),
        ("[learn-policy]\nwithout = 'feat'\n", ["[learn-policy] without", "a list"]),
        ("[learn-policy]\nwithout = ['fear']\n", ["[learn-policy] without", "feat or img"]),
        ("[learn-policy]\npreset = 'big'\n", ["[learn-policy] preset", "quick"]),
        ("[learn-policy]\nout = 'x.policy.h5'\n", ["[learn-policy] out"]),
        ("[learn-policy]\ndevice = 'banana'\n", ["--device banana"]),
        ("[learn-policy]\nreward = 'oracle'\nblur = 3.0\n", ["--blur 3 has no effect", "options come from"]),
        ("kl = 1.0\n", ["kl", "[learn-policy]"]),
        ("learn-policy = 3\n", ["learn-policy: expected a table"]),
        ("[learn-policy\n", ["is not TOML"]),
        (b"\x89HDF\r\n\x1a\n\0\0", ["is not TOML"]),
        ("[learn-policy]\nblur = " + "[" * 4000, ["is not TOML"]),
        ("[learn-policy]\nepisodes = " + "9" * 4060, ["expected at most"]),
        ("[learn-policy]\nepisodes = 0x" + "f" * 4000, ["expected at most"]),
        ("[learn-policy]\nepisodes = 9223372036854775808\n", ["expected at most 9223372036854775807"]),
        ("[learn-policy]\nblur = 1" + "0" * 400, ["a finite number"]),
        ("[learn-policy]\nweights = 'a\\u0000'\n".replace("'", '"'), ["NUL"]),
        ("[learn-policy]\nwithout = ['\\u0000']\n".replace("'", '"'), ["NUL"]),
        ("[learn-policy]\n" + ".".join("a" * 5000) + " = 1", ["too large", "4096 bytes in a line"]),
        ("# 34567\n" * 10_000, ["too large", "64 KiB"]),
        ('["\\u001b[2J\\n"]\n', ["\\u001b[2J\\u000a"]),
    ],
)
def test_what_is_wrong_with_a_file_is_one_line(run_ifo, calls, words_for, tmp_path, text, expected):
    file = tmp_path / "f.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    code, out, err = run_ifo(*words_for("learn-policy"), "--config", file)
    assert (code, out, calls) == (2, "", []) and err.startswith("ifo: ") and err.count("\n") == 1
    assert all(part in err for part in [str(file) if "banana" not in err else "", *expected]), err


def test_a_file_that_is_not_there(run_ifo, calls, words_for, tmp_path):
    code, out, err = run_ifo(*words_for("learn-policy"), "--config", tmp_path / "none.toml")
    assert (code, out, calls) == (2, "", []) and "none.toml" in err and err.count("\n") == 1


@pytest.mark.parametrize("kind", ["pipe", "zeros", "nothing", "folder", "loop", "long"])
def test_what_is_no_file_is_one_line(run_ifo, calls, words_for, tmp_path, kind):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    paths = {"zeros": "/dev/zero", "nothing": "/dev/null", "folder": tmp_path, "long": tmp_path / ("x" * 300)}
    code, out, err = run_ifo(*words_for("learn-policy"), "--config", paths.get(kind, tmp_path / kind))
    assert (code, out, calls) == (2, "", []) and err.startswith("ifo: --config ") and err.count("\n") == 1


def test_a_file_may_come_from_another_process(run_ifo, calls, words_for):
    reading, writing = os.pipe()  # as for `--config <(...)`
    os.write(writing, b"[learn-policy]\nkl = 0.5\n")
    os.close(writing)
    assert run_ifo(*words_for("learn-policy"), "--config", f"/dev/fd/{reading}")[0] == 0
    os.close(reading)
    assert calls[0][1][0].kl == 0.5


def test_names_add_no_lines_to_the_options(run_ifo, tmp_path):
    file = tmp_path / "a\n[evaluate]\nseed = 9.toml"
    file.write_text("[report]\ntitle = 'x'\n")
    code, shown, _ = run_ifo("report", "--config", file, "--show-config")
    assert code == 0 and tomllib.loads(shown) == {"report": {"title": "x"}}


def test_show_config_reads_no_standard_input(run_ifo):
    code, out, err = run_ifo("learn-policy", "--show-config", terminal=True)
    assert (code, err) == (0, "")
    values = tomllib.loads(out)["learn-policy"]
    assert values["preset"] == "quick" and values["iterations"] == PRESETS["quick"]["learn-policy"].iterations


@pytest.mark.parametrize("stage", STAGES)
def test_every_option_of_the_stage_is_shown(run_ifo, words_for, stage):
    shown = tomllib.loads(run_ifo(*words_for(stage), "--show-config")[1])[stage]
    assert {item.name for item in dataclasses.fields(STAGES[stage])} <= set(shown)
    assert ("device" in shown) == (stage in ("train-translator", "translate", "learn-policy"))


def test_texts_survive_toml(run_ifo, tmp_path):
    title = 'a "b" \\ \x7f \t é 😀'
    code, shown, _ = run_ifo("report", "--title", title, "--show-config")
    assert code == 0 and tomllib.loads(shown)["report"]["title"] == title


def test_refused_before_the_input_is_waited_for(run_ifo, calls, monkeypatch):
    """Else a pipe would run for hours before its last command says that it was typed wrongly."""
    for words in (
        ["learn-policy", "--reward", "oracle", "--blur", "3"],
        ["learn-policy", "--without", "feat", "--without", "img"],
        ["train-translator", "--steps", "0", "--mirror"],
        ["translate", "--device", "banana"],
        ["evaluate", "--episodes", "0"],
    ):
        code, out, err = run_ifo(*words, stdin="no path at all\n")
        assert (code, out) == (2, "") and words[1] in err and err.count("\n") == 1, err
    assert calls == []


def test_a_device_that_nothing_would_use_is_refused(run_ifo, calls, words_for):
    words = words_for("learn-policy")
    code, out, err = run_ifo(*words, "--reward", "oracle", "--device", "cuda")
    assert (code, out) == (2, "") and "--device has no effect with --reward oracle" in err
    assert run_ifo(*words, "--reward", "oracle", "--device", "cpu")[0] == 0, "that is where it runs"
    for stage in ("train-expert", "collect-demos", "evaluate"):
        assert run_ifo(*words_for(stage), "--device", "cpu")[0] == 2
    assert len(calls) == 1


@pytest.mark.parametrize("name", METHODS)
def test_what_reproduce_asks_for_is_not_refused(run_ifo, calls, words_for, name):
    method = METHODS[name]
    for preset in PRESETS:
        train = method.train if method.translator not in (BLANK, OWN) else ("--steps", "0")
        for words in (
            [*words_for("train-translator", preset=preset), *train],
            [*words_for("learn-policy", preset=preset), *method.learn],
        ):
            code, _, err = run_ifo(*words)
            assert code == 0, err


def test_a_users_task_brings_its_own_defaults(run_ifo, calls, words_for, tmp_path, monkeypatch):
    own = {"paper": {"train-expert": {"iterations": 3}, "train-translator": {"steps": 77}}}
    (tmp_path / "users.py").write_text(
        f"from tests.examples.glide import Glide as Plain\nclass Glide(Plain):\n    defaults = {own}\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert run_ifo("train-expert", "users:Glide", "--preset", "paper")[0] == 0
    assert calls[0][1][1].iterations == 3
    words = words_for("train-translator", task="users:Glide")
    code, _, err = run_ifo(*words)
    assert code == 0 and "its own defaults for train-translator" in err and "IFO_TASKS=users:Glide" in err
    assert calls[1][1][0].steps == PRESETS["paper"]["train-translator"].steps
    monkeypatch.setenv("IFO_TASKS", "users:Glide")
    code, _, err = run_ifo(*words)
    assert code == 0 and "IFO_TASKS" not in err
    assert calls[2][1][0].steps == 77
