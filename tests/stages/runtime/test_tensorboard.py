"""What cannot be written is one line, whoever fails to write it."""

import json
import os
import threading

import cv2
import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

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


def test_the_configuration_is_shown_as_text_in_which_nothing_is_interpreted(tmp_path):
    config = {"task": "a|b</code><script>", "steps": 3, "without": ["img"]}
    for done in (0, 5):
        with TensorBoard(tmp_path / f"{done}.tensorboard", done, config):
            pass
        found = EventAccumulator(str(tmp_path / f"{done}.tensorboard")).Reload()
        assert found.Tags()["tensors"] == ([] if done else ["configuration/text_summary"])
    found = EventAccumulator(str(tmp_path / "0.tensorboard")).Reload()
    [event] = found.Tensors("configuration/text_summary")
    text = event.tensor_proto.string_val[0].decode()
    assert all(line.startswith("    ") for line in text.splitlines()), "a code block of Markdown"
    assert json.loads(text) == config and event.step == 0


def test_pictures_are_shown_at_their_step(tmp_path):
    picture = np.random.default_rng(0).integers(0, 255, (6, 9, 3), dtype=np.uint8)
    with TensorBoard(tmp_path / "x.tensorboard") as board:
        board.show(7, "held-out translations", picture)
    found = EventAccumulator(str(tmp_path / "x.tensorboard")).Reload()
    [event] = found.Images("held-out translations")
    decoded = cv2.imdecode(np.frombuffer(event.encoded_image_string, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(decoded[..., ::-1], picture)
    assert event.step == 7
