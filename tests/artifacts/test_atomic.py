"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from artifacts import PlatformError, atomic, atomic_folder, atomic_path
from artifacts.atomic import write_bytes

ROOT = Path(__file__).parents[2]


def test_a_folder_appears_when_the_block_is_over(tmp_path):
    path = tmp_path / "new" / "set"
    with atomic_folder(path) as temporary:
        (temporary / "a").mkdir()
        (temporary / "a" / "b").write_text("text")
        assert not path.exists()
    assert (path / "a" / "b").read_text() == "text" and os.listdir(path.parent) == ["set"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_folder_that_fails_leaves_nothing(tmp_path, error):
    with pytest.raises(error), atomic_folder(tmp_path / "set") as temporary:
        (temporary / "b").write_text("text")
        raise error
    assert not os.listdir(tmp_path)


def test_an_interrupt_that_makes_the_clean_up_fail_is_still_an_interrupt(tmp_path, monkeypatch):
    def fails(*_, **__):
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))

    monkeypatch.setattr(shutil, "rmtree", fails)
    with pytest.raises(KeyboardInterrupt), atomic_folder(tmp_path / "set"):
        raise KeyboardInterrupt


@pytest.mark.parametrize(("module", "name"), [(tempfile, "mkdtemp"), (shutil, "rmtree")])
def test_an_interrupt_while_the_temporary_folder_is_made_or_removed_leaves_nothing(tmp_path, monkeypatch, module, name):
    usual = getattr(module, name)

    def interrupted(*arguments, **options):
        made = usual(*arguments, **options) if name == "mkdtemp" else None
        os.kill(os.getpid(), signal.SIGINT)
        return usual(*arguments, **options) if name == "rmtree" else made

    monkeypatch.setattr(module, name, interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_path(tmp_path / "x") as temporary:
        temporary.write_text("whole")
    assert [path for path in os.listdir(tmp_path) if path != "x"] == []


@pytest.mark.parametrize("fails", [False, True])
def test_an_interrupt_just_before_the_clean_up_leaves_nothing(tmp_path, monkeypatch, fails):
    usual, calls = atomic.deferred_interrupts, []

    def interrupted():
        calls.append(len(os.listdir(tmp_path)))
        if len(calls) == 2:  # The first one makes the folder.
            raise KeyboardInterrupt
        return usual()

    monkeypatch.setattr(atomic, "deferred_interrupts", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_path(tmp_path / "x") as temporary:
        temporary.write_text("whole")
        if fails:
            raise ValueError
    assert os.listdir(tmp_path) == ([] if fails else ["x"])
    assert calls[0] == 0 and len(calls) == 3


def test_a_folder_never_replaces_anything(tmp_path):
    with pytest.raises(PlatformError, match="of that name exists"), atomic_folder(tmp_path / "set"):
        (tmp_path / "set").mkdir()
    assert os.listdir(tmp_path) == ["set"]


WRITER = """
import sys
from artifacts.atomic import atomic_folder, atomic_path
make = atomic_folder if sys.argv[2] == "folder" else atomic_path
with make(sys.argv[1]) as temporary:
    (temporary / "part" if sys.argv[2] == "folder" else temporary).write_text("half")
    print("ready", flush=True)
    sys.stdin.read()
"""


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_killed_writers_rest_is_removed_by_the_next_and_a_live_ones_is_not(tmp_path, kind):
    path, other = tmp_path / "set", tmp_path / "set.other"
    command = [sys.executable, "-c", WRITER]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "cwd": ROOT}
    writers = [subprocess.Popen([*command, str(target), kind], **pipes) for target in (path, other)]
    try:
        assert all(writer.stdout.readline() == b"ready\n" for writer in writers)
        begun = sorted(os.listdir(tmp_path))
        assert len(begun) == 2
        write_bytes(tmp_path / "set", b"whole")
        assert sorted(os.listdir(tmp_path)) == [*begun, "set"], "both writers live"
        for writer in writers:
            writer.kill()
            writer.wait()
        write_bytes(tmp_path / "set", b"again")
    finally:
        for writer in writers:
            writer.kill()
            writer.communicate()
    left = [name for name in begun if name.startswith(".set.other.tmp-")]
    assert sorted(os.listdir(tmp_path)) == [*left, "set"], "a writer clears away what was to be its own file"
    assert path.read_bytes() == b"again"


def test_a_pipe_that_is_named_like_a_temporary_folder_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / ".x.tmp-pipe")
    write_bytes(tmp_path / "x", b"whole")
    assert os.listdir(tmp_path) == ["x"]


def test_two_writers_of_one_file_share_nothing(tmp_path, monkeypatch):
    """As in two containers on one volume, where both may have the same process id."""
    monkeypatch.setattr(os, "getpid", lambda: 7)
    path = tmp_path / "x"
    with atomic_path(path) as first:
        first.write_text("first")
        with atomic_path(path) as second:
            assert first != second
            second.write_text("second")
        assert path.read_text() == "second"
        assert first.read_text() == "first"
    assert path.read_text() == "first"
    assert os.listdir(tmp_path) == ["x"]


def test_a_file_system_without_locks_is_written_to_and_never_cleared(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("artifacts.atomic.fcntl.flock", refuse)
    (tmp_path / ".x.tmp-left").mkdir()
    write_bytes(tmp_path / "x", b"whole")
    assert sorted(os.listdir(tmp_path)) == [".x.tmp-left", "x"]
