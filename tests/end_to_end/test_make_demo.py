"""`make demo`, killed once in each of its stages and started again each time, ends as an undisturbed run does."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from artifacts import read_artifact

ROOT = Path(__file__).resolve().parents[2]
KINDS = ("expert", "demos", "translator", "translation", "policy", "evaluation")
CHECKPOINTS = ("expert", "translator", "policy")
LIMIT = {"toy": 300, "quick": 5400}  # seconds of one run

pytestmark = [pytest.mark.gl, pytest.mark.slow]


@pytest.fixture
def place(tmp_path):
    """Returns a folder in which `make demo` runs the code of this repository."""

    def made(name):
        folder = tmp_path / name
        programs = folder / ".venv" / "bin"
        programs.mkdir(parents=True)
        for program, words in (("ifo", "-m ifo_cli.main"), ("python", "")):
            (programs / program).write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} {words} "$@"\n')
            (programs / program).chmod(0o755)
        (folder / ".ci").mkdir()
        for file in ("Makefile", "pyproject.toml", "constraints.txt", ".ci/setup.sh"):
            shutil.copy(ROOT / file, folder / file)
        (folder / ".venv" / ".stamp").touch()
        return folder

    return made


def demo(folder, preset):
    """Start `make demo`."""
    words = ["make", "demo", f"PRESET={preset}"]
    log = (folder / "log").open("a")
    return subprocess.Popen(words, cwd=folder, stdout=log, stderr=log, start_new_session=True)


def finish(folder, preset):
    assert demo(folder, preset).wait(LIMIT[preset]) == 0, (folder / "log").read_text()[-3000:]


def kill_in(folder, preset, kind):
    """Start `make demo`, and kill all its processes in the stage that makes a kind of artifact."""
    before = dict(zip(KINDS[1:], KINDS, strict=False)).get(kind)
    process = demo(folder, preset)
    deadline = time.monotonic() + LIMIT[preset]
    # With preset toy, a stage ends before its first checkpoint: it is killed soon after the stage before it has ended.
    checkpoint = preset != "toy" and kind in CHECKPOINTS
    wanted = f"runs/*.{kind}.checkpoint.h5" if checkpoint else f"runs/*.{before}.h5" if before else "runs"
    while not any(folder.glob(wanted)):
        assert process.poll() is None and time.monotonic() < deadline, (folder / "log").read_text()[-3000:]
        time.sleep(0.01)
    time.sleep(0.3)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not any((folder / "runs").glob(f"*.{kind}.h5")), f"{kind} had already been written"


def contents(folder):
    found = {read_artifact(path).kind: read_artifact(path).content for path in (folder / "runs").glob("*.h5")}
    assert sorted(found) == sorted(KINDS)
    return found


@pytest.mark.parametrize("preset", ["toy", "quick"])
def test_killed_in_every_stage_it_ends_as_undisturbed(place, preset):
    undisturbed, killed = place("undisturbed"), place("killed")
    finish(undisturbed, preset)
    for kind in KINDS:
        kill_in(killed, preset, kind)
    finish(killed, preset)
    assert contents(killed) == contents(undisturbed)
    ends = [json.loads((folder / "runs" / "demo.json").read_text()) for folder in (undisturbed, killed)]
    assert ends[0]["normalised_distance"] == ends[1]["normalised_distance"]
    started = time.monotonic()
    finish(killed, preset)
    assert contents(killed) == contents(undisturbed)
    if preset == "quick":
        assert time.monotonic() - started < 20
