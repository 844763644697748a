"""Exports that are stopped, or cannot be written, leave and replace nothing."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import sys
from pathlib import Path

import pytest

from artifacts import read_artifact
from stages import export_demos
from stages.datasets import hdf5_writing
from tests.stages.export_demos.samples import FORMATS, N, frames_of


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_a_stopped_export_leaves_nothing(ifo, demos, tmp_path, monkeypatch, name, error):
    path = demos()

    def stop(artifact, *_):
        yield artifact["frames"][0], artifact["times"][0]
        raise error

    monkeypatch.setattr("stages.export_demos._videos", stop)
    words = ["--video"] if name == "lerobot" else []
    code, printed, _ = ifo("export-demos", path, "--format", name, *words)
    assert (code, printed) == (130 if error is KeyboardInterrupt else 1, None)
    assert [file.name for file in tmp_path.iterdir()] == ["x.demos.h5"]


@pytest.mark.parametrize("name", ["robomimic", "minari"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_killed_export_leaves_nothing(ifo, demos, tmp_path, monkeypatch, name, number):
    path = demos()
    before = signal.getsignal(number)
    write = hdf5_writing._write

    def killed(*_):
        with contextlib.suppress(KeyboardInterrupt):  # as h5py's callbacks do
            os.kill(os.getpid(), number)
        monkeypatch.setattr(hdf5_writing, "_write", write)

    monkeypatch.setattr(hdf5_writing, "_write", killed)
    code, printed, said = ifo("export-demos", path, "--format", name)
    assert (code, printed, said.splitlines()[-1]) == (130, None, "ifo: interrupted")
    assert [file.name for file in tmp_path.iterdir()] == ["x.demos.h5"] and signal.getsignal(number) == before


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_demonstrations_leave_nothing(ifo, demos, tmp_path, name):
    path = demos()
    data = bytearray(path.read_bytes())
    at = data.index(read_artifact(path)["frames"][3].tobytes()[:64])
    data[at] ^= 1
    path.write_bytes(data)
    code, printed, said = ifo("export-demos", path, "--format", name)
    assert (code, printed) == (3, None) and "dataset frames is damaged" in said.splitlines()[-1]
    assert [file.name for file in tmp_path.iterdir()] == ["x.demos.h5"]


@pytest.mark.parametrize("name", FORMATS)
def test_nothing_is_replaced(ifo, demos, tmp_path, name):
    path = demos()
    (tmp_path / FORMATS[name]).mkdir()
    code, _, said = ifo("export-demos", path, "--format", name)
    assert (
        code == 2
        and said == f"ifo: {tmp_path / FORMATS[name]}: already exists: remove it, or choose another name with --out\n"
    )


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("kind", ["pipe", "file", "broken link", "link to a folder"])
def test_nothing_of_any_kind_is_replaced(ifo, demos, tmp_path, name, kind):
    path, out = demos(), tmp_path / FORMATS[name]
    (tmp_path / "folder").mkdir()
    {
        "pipe": os.mkfifo,
        "file": Path.touch,
        "broken link": lambda out: out.symlink_to("nowhere"),
        "link to a folder": lambda out: out.symlink_to("folder"),
    }[kind](out)
    code, _, said = ifo("export-demos", path, "--format", name)
    assert code == 2 and "already exists" in said and said.count("\n") == 1
    assert len(list(tmp_path.iterdir())) == 3 and not list((tmp_path / "folder").iterdir())


@pytest.mark.parametrize("name", FORMATS)
def test_names_that_no_file_can_have(ifo, demos, tmp_path, name):
    out = tmp_path / ("a" * 300 + FORMATS[name])
    code, _, said = ifo("export-demos", demos(), "--format", name, "--out", out)
    assert code == 4 and "File name too long" in said.splitlines()[-1]


@pytest.fixture
def files_of_at_most():
    """A function that limits the size of files, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("words", [["lerobot"], ["lerobot", "--video"], ["robomimic"], ["minari"]])
@pytest.mark.parametrize("size", [1000, 30_000])
def test_a_full_disk_leaves_nothing(ifo, demos, tmp_path, files_of_at_most, words, size):
    path = demos()
    files_of_at_most(size)
    code, printed, said = ifo("export-demos", path, "--format", *words)
    assert (code, printed) == (4, None) and "cannot be written" in said.splitlines()[-1] and "File too large" in said
    assert [file.name for file in tmp_path.iterdir()] == ["x.demos.h5"]


@pytest.mark.parametrize("name", FORMATS)
def test_an_export_grows_in_a_hidden_folder_that_the_next_one_removes(ifo, demos, tmp_path, monkeypatch, name):
    """What SIGKILL leaves behind does not look finished, and does not stay."""
    path, seen = demos(), []
    left = tmp_path / f".{FORMATS[name]}.tmp-killed" / "new"
    left.mkdir(parents=True)
    videos = export_demos._videos

    def watched(*words):
        for video in videos(*words):
            seen.append({file.name for file in tmp_path.iterdir()})
            yield video

    monkeypatch.setattr(export_demos, "_videos", watched)
    assert ifo("export-demos", path, "--format", name)[0] == 0
    assert all(len(names) == 2 and any(each.startswith(f".{FORMATS[name]}.tmp-") for each in names) for names in seen)
    assert len(seen) == N and sorted(file.name for file in tmp_path.iterdir()) == sorted(["x.demos.h5", FORMATS[name]])


def test_odd_frames_make_no_video_but_pictures(ifo, demos, tmp_path):
    path = demos(frames_of(49, 63))
    code, _, said = ifo("export-demos", path, "--format", "lerobot", "--video")
    assert code == 3 and "omit --video" in said and said.count("\n") == 1
    assert ifo("export-demos", path, "--format", "lerobot")[0] == 0


def test_without_pyarrow_a_line_says_what_to_install(ifo, demos, tmp_path, monkeypatch):
    path = demos()
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    code, _, said = ifo("export-demos", path, "--format", "lerobot")
    assert code == 4 and said == "ifo: LeRobot datasets need pyarrow: pip install 'ifo[lerobot]'\n"
    assert [file.name for file in tmp_path.iterdir()] == ["x.demos.h5"]
    assert ifo("export-demos", path, "--format", "robomimic")[0] == 0
