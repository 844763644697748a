"""Folders that appear whole or not at all."""

from __future__ import annotations

import os
import time

import pytest

from artifacts import PlatformError, atomic_folder


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


def test_a_folder_never_replaces_anything(tmp_path):
    with pytest.raises(PlatformError, match="in the way"), atomic_folder(tmp_path / "set"):
        (tmp_path / "set").mkdir()
    assert os.listdir(tmp_path) == ["set"]


def test_what_a_killed_writer_left_is_removed_in_time(tmp_path):
    old, recent = tmp_path / ".set.tmp-99999998", tmp_path / ".set.tmp-99999999"
    for folder in (old, recent):
        folder.mkdir()
        (folder / "file").touch()
    for file in (old / "file", old, recent):
        os.utime(file, (time.time() - 1000,) * 2)
    with atomic_folder(tmp_path / "set"):
        pass
    assert sorted(os.listdir(tmp_path)) == [recent.name, "set"]
