"""The harness notices each way in which a command may end badly, and a sample of its injections finds none."""

from __future__ import annotations

import faulthandler
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from artifacts import write_artifact
from tests.faults.__main__ import blame, lines_of, load_kinds, schedule
from tests.faults.case import KINDS, Case
from tests.faults.injections.damage import read_back
from tests.faults.server import Outcome, complaint, run, start

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = 30
NEED_OTHER_STAGES = ("not finite", "hostile lineage", "swapped chunks", "reproduce, stopped and started again")
STAGES = "import-demos,export-demos lerobot,export-demos robomimic"  # They take less than a second.


def says(text, code=3):
    def task():
        print(text, file=sys.stderr)
        return code

    return task


def raises():
    raise ValueError("a bug")


def crashes():
    faulthandler.disable()
    os.kill(os.getpid(), signal.SIGSEGV)


def works_forever():
    while True:
        pass


def names_its_file_and_prints_a_path():
    print("path")
    return says("ifo: x.h5: is damaged")()


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "case").mkdir()
    return tmp_path / "case"


@pytest.mark.parametrize(
    ("task", "problem"),
    [
        (says("ifo: x.h5: is damaged: restore it"), ""),
        (lambda: 0, ""),
        (crashes, "crashes: SIGSEGV"),
        (raises, "traceback"),
        (works_forever, "hangs"),
        (says("ifo: a\nifo: b"), "2 error lines"),
        (says("damaged"), "0 error lines"),
        (says("ifo: a \x1b[31mb"), "control characters"),
        (says("ifo: a", 2), "exit code 2, expected 0/3"),
        (names_its_file_and_prints_a_path, "although it failed"),
    ],
)
def test_a_bad_end_is_noticed(folder, task, problem):
    found = complaint(
        run(folder, task, cpu_seconds=1 if task is works_forever else 20),
        (0, 3),
    )
    assert found.startswith(problem) if not problem else problem in found
    assert bool(found) == bool(problem), found


def test_memory_out_of_proportion_is_noticed():
    outcome = Outcome(0, "", "", 0.1, resident=2 << 30, hung=False)
    assert complaint(outcome, (0,), resident=1 << 30).startswith("needs 2048 MiB")
    assert complaint(outcome, (0,), resident=2 << 30) == ""


def test_waiting_forever_is_noticed(folder):
    outcome = start(folder, lambda: time.sleep(1000) or 0).wait(limit=0.3)
    assert "hangs" in complaint(outcome, (0, 3))


def test_other_data_is_noticed(folder):
    arrays = {"frames": np.zeros((8, 5, 16, 16, 3), np.uint8), "final_distance": np.zeros(8)}
    paths = []
    for name, value in (("x.demos.h5", 0), ("y.demos.h5", 1)):
        arrays["frames"][0, 0, 0, 0, 0] = value
        paths.append(write_artifact(folder / name, "demos", arrays, config={}, seed=0, command="ifo"))
    same = run(folder, lambda: read_back(paths[0], paths[0]))
    other = run(folder, lambda: read_back(paths[1], paths[0]))
    assert complaint(same, (0, 3)) == "" and "silent" in complaint(other, (0, 3))


def test_what_a_failed_stage_leaves_is_noticed(folder):
    (folder / ".x.demos.h5.tmp-abc").mkdir()
    case = Case(None, folder, np.random.default_rng(0))
    assert "tmp-abc" in case.judge_leftovers()


@pytest.mark.gl
def test_a_sample_of_injections_is_handled():
    load_kinds()
    kinds = [word for name in KINDS if name not in NEED_OTHER_STAGES for word in ("--only", name)]
    words = ["--n", str(SAMPLE), "--seed", "7", "--stages", STAGES, "--jobs", "1", *kinds]
    done = subprocess.run(
        [sys.executable, "-m", "tests.faults", *words], cwd=ROOT, capture_output=True, text=True, timeout=900
    )
    assert f"{SAMPLE} injections, 0 failed" in done.stdout and done.returncode == 0, done.stdout + done.stderr


def test_every_kind_is_in_a_small_sample():
    load_kinds()
    assert set(schedule(list(KINDS), SAMPLE, 7)) == set(KINDS)


def test_an_injection_that_ends_the_harness_counts_as_failed(tmp_path):
    log = tmp_path / "log-1"
    log.write_text('{"case": 1, "problem": ""}\n{"case": 3, "pro')
    blame(1, ["a"] * 6, 2, log, {3}, "ended")
    assert [(line["case"], bool(line["problem"])) for line in lines_of(log)] == [(1, False), (5, True)]
