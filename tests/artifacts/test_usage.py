"""Marks of files in use: seen by others, and gone with the process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from artifacts.usage import InUse, is_used, unused

ROOT = Path(__file__).parents[2]


def test_a_mark_lasts_until_its_end(tmp_path):
    path = tmp_path / "x"
    path.write_text("")
    assert not is_used(path) and not is_used(tmp_path)
    mark, other = InUse([path, tmp_path]), InUse([path])
    assert is_used(path) and is_used(tmp_path)
    mark.end()
    assert is_used(path) and not is_used(tmp_path)
    del other
    assert not is_used(path)


def test_what_cannot_be_marked_is_no_error(tmp_path):
    InUse([tmp_path / "none", "a\0b"]).end()
    assert is_used(tmp_path / "none")  # not known to be free


def test_nobody_marks_what_is_being_removed(tmp_path):
    with unused(tmp_path) as free, unused(tmp_path) as again:
        assert free and not again


def test_the_mark_of_another_process_ends_with_it(tmp_path):
    code = "import sys; from artifacts.usage import InUse; mark = InUse(sys.argv[1:]); print('x', flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT
    ) as other:
        other.stdout.readline()
        assert is_used(tmp_path)
        other.kill()
        other.wait()
    assert not is_used(tmp_path)
