"""Lines of progress, where standard error is no terminal."""

from __future__ import annotations

import io
import sys

import pytest

from stages.runtime import progress
from stages.runtime.progress import Progress


@pytest.fixture
def clock(monkeypatch):
    """The time in seconds, as a list of one number that a test sets."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_work_that_comes_in_one_update_has_a_rate(clock, capsys):
    with Progress().bar("collect", 8, "demos") as bar:
        clock[0] += 4
        bar.update(8)
    assert capsys.readouterr().err == "collect: 8/8 demos, 2.0/s\n"


def test_what_an_interrupted_run_did_is_not_in_the_rate(clock, capsys):
    with Progress().bar("train", 100, "steps", done=50) as bar:
        bar.update(50)
        clock[0] += 5
        bar.update(60, loss=0.5)
    assert capsys.readouterr().err == "train: 60/100 steps, 2.0/s, 20 s left, loss 0.5\n"


def test_lines_come_at_intervals_and_the_last_one_always(clock, capsys):
    with Progress().bar("x", 30, "units") as bar:
        for done in range(1, 31):
            clock[0] += 1
            bar.update(done)
    assert [line.split(",")[0] for line in capsys.readouterr().err.splitlines()] == ["x: 15/30 units", "x: 30/30 units"]


def test_quiet_is_quiet(clock, capsys):
    with Progress(quiet=True).bar("x", 1, "units") as bar:
        bar.update(1)
    Progress(quiet=True).say("x")
    assert capsys.readouterr() == ("", "")


def test_a_terminal_shows_the_rate_too(clock, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    with Progress().bar("train", 8, "steps", done=4) as bar:
        clock[0] += 2
        bar.update(8)
    assert "steps 2.0/s" in sys.stderr.getvalue()
