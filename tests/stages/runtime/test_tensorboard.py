"""What cannot be written is one line, whoever fails to write it."""

import os
import threading

import pytest

from artifacts import PlatformError
from artifacts.usage import is_used
from stages.runtime.tensorboard import TensorBoard


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(PlatformError, match=r"x\.tensorboard: cannot be written .*choose another location"):
        TensorBoard(tmp_path / "file" / "x.tensorboard")


def test_a_path_that_is_not_utf8(tmp_path):
    with pytest.raises(PlatformError, match="choose another location"):
        TensorBoard(tmp_path / os.fsdecode(b"\xff.tensorboard"))


def test_a_disk_that_is_full(tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tensorboard.summary.writer.record_writer.RecordWriter.write", full)
    with pytest.raises(PlatformError, match="No space left on device"):
        TensorBoard(tmp_path / "x.tensorboard")
    assert capsys.readouterr().err == "" and not any(tmp_path.iterdir())


def test_other_threads_are_heard_of(tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(threading, "excepthook", told.append)
    with TensorBoard(tmp_path / "x.tensorboard") as board:
        board.write(1, {"loss": 1.0, "nothing": float("nan")})
        thread = threading.Thread(target=lambda: 1 / 0)
        thread.start(), thread.join()
    assert [what.exc_type for what in told] == [ZeroDivisionError]


def test_the_programs_own_hook_is_put_back(tmp_path, monkeypatch):
    def own(what):
        pass

    monkeypatch.setattr(threading, "excepthook", own)
    with TensorBoard(tmp_path / "x.tensorboard"):
        assert threading.excepthook is not own
    assert threading.excepthook is own
    with pytest.raises(RuntimeError), TensorBoard(tmp_path / "x.tensorboard"):
        raise RuntimeError
    assert threading.excepthook is own
    (tmp_path / "file").write_text("")
    with pytest.raises(PlatformError):
        TensorBoard(tmp_path / "file" / "x.tensorboard")
    assert threading.excepthook is own


def test_its_folder_is_marked_as_used(tmp_path):
    with TensorBoard(tmp_path / "x.tensorboard"):
        assert is_used(tmp_path / "x.tensorboard")
    assert not is_used(tmp_path / "x.tensorboard")
