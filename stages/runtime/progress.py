"""Progress on standard error: a bar with rate and time left on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

PLAIN_INTERVAL = 15.0  # seconds between two plain lines


class Progress:
    """Where a stage says how far it is. Nothing here ever writes to standard output."""

    def __init__(self, quiet: bool = False):
        self._quiet = quiet

    def say(self, text: str) -> None:
        """One line for people."""
        if not self._quiet:
            _print_line(text)

    @contextmanager
    def bar(self, description: str, total: int, unit: str) -> Iterator[Bar]:
        """Show work of `total` units while the block runs."""
        if self._quiet:
            yield Bar()
        elif sys.stderr.isatty():
            with _rich_bar(description, total, unit) as bar:
                yield bar
        else:
            bar = _PlainBar(description, total, unit)
            yield bar
            bar.finish()


class Bar:
    """Progress of one piece of work."""

    def update(self, done: int, **figures: Any) -> None:
        """Say that `done` units are done, with figures of the moment."""


class _PlainBar(Bar):
    def __init__(self, description: str, total: int, unit: str):
        self._description, self._total, self._unit = description, total, unit
        self._start = self._last = time.monotonic()
        self._first: int | None = None
        self._line = self._printed = ""

    def update(self, done: int, **figures: Any) -> None:
        now = time.monotonic()
        if self._first is None:
            self._first = done
        rate = max(done - self._first, 0) / max(now - self._start, 1e-9)
        left = f", {(self._total - done) / rate:.0f} s left" if rate > 0 and done < self._total else ""
        self._line = f"{self._description}: {done}/{self._total} {self._unit}, {rate:.1f}/s{left}{_format(figures)}"
        if now - self._last >= PLAIN_INTERVAL:
            self._last, self._printed = now, self._line
            _print_line(self._line)

    def finish(self) -> None:
        if self._line != self._printed:
            _print_line(self._line)


def _print_line(text: str) -> None:
    with suppress(OSError):  # Nobody reads standard error any more: no reason to stop the work.
        print(text, file=sys.stderr, flush=True)


def _format(figures: dict[str, Any]) -> str:
    return "".join(
        f", {name} {value:.3g}" if isinstance(value, float) else f", {name} {value}" for name, value in figures.items()
    )


@contextmanager
def _rich_bar(description: str, total: int, unit: str) -> Iterator[Bar]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as RichProgress

    columns = [
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(f"{unit} {{task.fields[rate]}}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[figures]}"),
    ]
    with RichProgress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task(description, total=total, figures="", rate="")
        start, first = time.monotonic(), [-1]

        class RichBar(Bar):
            def update(self, done: int, **figures: Any) -> None:
                first[0] = done if first[0] < 0 else first[0]
                rate = max(done - first[0], 0) / max(time.monotonic() - start, 1e-9)
                progress.update(task, completed=done, rate=f"{rate:.1f}/s", figures=_format(figures).removeprefix(", "))

        yield RichBar()
