"""Sizes, ages, counts and tables as text."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence

from stages.runtime.terminal import one_line

AGES = ((86400 * 365, "y"), (86400, "d"), (3600, "h"), (60, "min"), (1, "s"))
GAP = "  "  # between columns


def size_text(number: float) -> str:
    """Return a number of bytes in the unit in which it is easiest to read."""
    for unit in ("B", "KiB", "MiB"):
        if number < 1024:
            return f"{number:.0f} {unit}" if unit == "B" else f"{number:.1f} {unit}"
        number /= 1024
    return f"{number:.1f} GiB"


def age_text(seconds: float) -> str:
    """Return a duration in its largest unit, rounded down; a negative one is 0 s."""
    for length, unit in AGES:
        if seconds >= length:
            return f"{seconds // length:.0f} {unit}"
    return "0 s"


def count_text(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural if needed."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def table_text(heads: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[str] = ()) -> str:
    """Return a table, with long cells folded where it is wider than the terminal; without a terminal, nothing is.

    Args:
        heads: Heading of each column.
        rows: Cells of each row, one line each once what is not printable is escaped.
        right: Headings of columns that are aligned on the right.
    """
    from rich.cells import cell_len

    table = [list(heads), *([one_line(cell) for cell in row] for row in rows)]
    widths = [max(map(cell_len, column)) for column in zip(*table, strict=True)]
    if sys.stdout.isatty() and sum(widths) + len(GAP) * len(widths) > shutil.get_terminal_size().columns:
        return _folded(table, right)
    lines = []
    for row in table:
        room = [" " * (width - cell_len(cell)) for width, cell in zip(widths, row, strict=True)]
        parts = zip(heads, row, room, strict=True)
        lines.append(GAP.join(space + cell if head in right else cell + space for head, cell, space in parts).rstrip())
    return "\n".join(lines)


def _folded(table: Sequence[Sequence[str]], right: Sequence[str]) -> str:
    from io import StringIO

    from rich.console import Console
    from rich.table import Table

    text = StringIO()
    columns = shutil.get_terminal_size().columns
    console = Console(file=text, width=columns, highlight=False, emoji=False, markup=False)
    shown = Table(box=None, pad_edge=False)
    for head in table[0]:
        shown.add_column(head, overflow="fold", justify="right" if head in right else "left")
    for row in table[1:]:
        shown.add_row(*row)
    console.print(shown)
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines())
