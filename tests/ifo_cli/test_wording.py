"""Sizes, ages and tables as text."""

from __future__ import annotations

import os
import shutil
import sys

import pytest

from ifo_cli.wording import age_text, count_text, size_text, table_text


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (0, "0 B"),
        (1023, "1023 B"),
        (1024, "1.0 KiB"),
        (3 << 20, "3.0 MiB"),
        (5 << 30, "5.0 GiB"),
        (1 << 42, "4096.0 GiB"),
    ],
)
def test_sizes(number, expected):
    assert size_text(number) == expected


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        (-5, "0 s"),
        (0.5, "0 s"),
        (59.9, "59 s"),
        (60, "1 min"),
        (7199, "1 h"),
        (86400 * 300, "300 d"),
        (86400 * 800, "2 y"),
    ],
)
def test_ages(seconds, expected):
    assert age_text(seconds) == expected


def test_counts():
    assert [count_text(number, "file") for number in (0, 1, 2)] == ["0 files", "1 file", "2 files"]


ROWS = [("a", "1 B", "x"), ("視覚" + "b" * 5, "10 B", "y\n\x1b[31m")]


def test_a_table_without_a_terminal_is_as_wide_as_needed():
    assert table_text(("name", "size", "note"), ROWS, right=("size",)).split("\n") == [
        "name       size  note",
        "a           1 B  x",
        "視覚bbbbb  10 B  y\\u000a\\u001b[31m",
    ]


def test_a_table_is_folded_in_a_narrow_terminal(monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(shutil, "get_terminal_size", lambda: os.terminal_size((20, 24)))
    lines = table_text(("name", "note"), [("x" * 30, "[b]y[/b]")]).split("\n")
    assert max(map(len, lines)) <= 20 and len(lines) > 2
    assert "".join("".join(line.split()[:1]) for line in lines[1:]).count("x") == 30
    monkeypatch.setattr(shutil, "get_terminal_size", lambda: os.terminal_size((200, 24)))
    assert table_text(("name", "note"), [("x" * 30, "[b]y[/b]")]).split("\n")[1] == "x" * 30 + "  [b]y[/b]"
