"""`kill` ends a command as Ctrl-C does."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.gl
def test_killed_while_it_films_it_leaves_nothing_behind(tmp_path):
    words = ["collect-demos", "push-real", "--videos", str(tmp_path / "footage"), "--out", str(tmp_path / "x.demos.h5")]
    process = subprocess.Popen(
        [sys.executable, "-m", "ifo_cli.main", *words], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    while not list(tmp_path.glob(".footage.tmp-*/*/*.mp4")):
        assert process.poll() is None
        time.sleep(0.05)
    process.terminate()
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.splitlines()[-1] == "ifo: interrupted" and "Traceback" not in said
    assert not list(tmp_path.iterdir())
