"""The whole pipeline at toy size, run once, as a user would: five commands joined by pipes."""

from __future__ import annotations

import contextlib
import fcntl
import io
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from ifo_cli.main import main

IFO = f"{shlex.quote(sys.executable)} -m ifo_cli.main"
PIPELINE = (
    f"{IFO} collect-demos reach --preset toy --seed 5 | {IFO} train-translator --preset toy | {IFO} translate"
    f" | {IFO} learn-policy --preset toy | {IFO} evaluate --json"
)


@dataclass(frozen=True)
class ToyRun:
    """A finished toy pipeline: its folder, seconds, standard output and standard error."""

    folder: Path
    seconds: float
    stdout: str
    stderr: str

    @property
    def summary(self) -> dict:
        return json.loads(self.stdout)

    def artifact(self, kind: str) -> Path:
        (path,) = (self.folder / "runs").glob(f"*.{kind}.h5")
        return path


def environment() -> dict[str, str]:
    root = Path(__file__).resolve().parents[2]
    paths = [str(root), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}


@pytest.fixture(scope="session")
def toy(tmp_path_factory, worker_id):
    """The finished pipeline, in a folder of this process's own; of several test processes one alone runs it."""
    base = tmp_path_factory.getbasetemp()
    shared = (base if worker_id == "master" else base.parent) / "toy"
    shared.mkdir(exist_ok=True)
    with open(shared / "lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (shared / "run.json").exists():
            (shared / "run.json").write_text(json.dumps(_run_pipeline(shared / "made")))
    folder = tmp_path_factory.mktemp("own") / "made"
    shutil.copytree(shared / "made", folder)
    return ToyRun(folder, *json.loads((shared / "run.json").read_text()))


def _run_pipeline(folder: Path) -> tuple[float, str, str]:
    """Seconds, standard output and standard error of the pipeline, run in `folder`."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    start = time.monotonic()
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", PIPELINE], cwd=folder, env=environment(), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return time.monotonic() - start, done.stdout, done.stderr


@pytest.fixture(scope="session")
def ifo():
    """A function that runs one `ifo` command in a folder, within this process, and returns what became of it."""
    return _run


@pytest.fixture(scope="session")
def ifo_process():
    """The same by a process of its own, which takes seconds longer: to be given an input, say."""

    def run(folder: Path, *words: object, **options) -> subprocess.CompletedProcess:
        command = [sys.executable, "-m", "ifo_cli.main", *map(str, words)]
        return subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, **options)

    return run


def _run(folder: Path, *words: object) -> subprocess.CompletedProcess:
    out, err = io.StringIO(), io.StringIO()
    command = [*map(str, words)]
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(command)
    return subprocess.CompletedProcess(["ifo", *command], code, out.getvalue(), err.getvalue())
