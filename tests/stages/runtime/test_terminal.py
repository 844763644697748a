"""Lines on standard error."""

import sys

import pytest

from stages.runtime.terminal import LONGEST, one_line, say


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain text, é 漢", "plain text, é 漢"),
        ("a\nb\tc\rd\0", "a\\u000ab\\u0009c\\u000dd\\u0000"),
        ("\x1b[31m\x7f\x9b", "\\u001b[31m\\u007f\\u009b"),
        ("\u202e\u2066\u2028\ud800\U000e0001", "\\u202e\\u2066\\u2028\\ud800\\U000e0001"),
    ],
)
def test_what_is_not_printable_is_escaped(text, shown):
    assert one_line(text) == shown and shown.isprintable()


def test_the_middle_of_a_long_line_is_left_out(capsys):
    say(f"begin {'x' * 10 * LONGEST}\n end")
    line = capsys.readouterr().err
    assert line.startswith("begin x") and line.endswith("x\\u000a end\n") and len(line) < LONGEST + 20


def test_without_standard_error_nothing_is_printed(capsys, monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    say("lost")
    assert capsys.readouterr().out == ""
