"""Progress on standard error: a bar with rate and remaining time on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from stages.runtime.terminal import say

PLAIN_INTERVAL = 15.0  # seconds between two plain lines


class Progress:
    """Progress reports of a stage. They never go to standard output."""

    def __init__(self, quiet: bool = False):
        self._quiet = quiet

    def say(self, text: str) -> None:
        """Print one line for the user."""
        if not self._quiet:
            say(text)

    def warn(self, text: str) -> None:
        """Print one line about data that is left out or damaged; --quiet does not hide it."""
        say(text)

    @contextmanager
    def bar(self, description: str, total: int, unit: str, done: int = 0) -> Iterator[Bar]:
        """Show the progress of `total` units during the block; an interrupted run has done the first `done` units."""
        if self._quiet:
            yield Bar()
        elif sys.stderr is not None and sys.stderr.isatty():
            with _rich_bar(description, total, unit, done) as bar:
                yield bar
        else:
            bar = _PlainBar(description, total, unit, done)
            yield bar
            bar.finish()


class Bar:
    """Progress display of one task."""

    def update(self, done: int, **figures: Any) -> None:
        """Show the number of finished units, `done`, and current figures."""


class _PlainBar(Bar):
    def __init__(self, description: str, total: int, unit: str, done: int):
        self._description, self._total, self._unit = description, total, unit
        self._rate = _Rate(done)
        self._last = time.monotonic()
        self._line = self._printed = ""

    def update(self, done: int, **figures: Any) -> None:
        now = time.monotonic()
        rate = self._rate(done)
        left = f", {(self._total - done) / rate:.0f} s left" if rate > 0 and done < self._total else ""
        self._line = f"{self._description}: {done}/{self._total} {self._unit}, {rate:.1f}/s{left}{_format(figures)}"
        if now - self._last >= PLAIN_INTERVAL:
            self._last, self._printed = now, self._line
            say(self._line)

    def finish(self) -> None:
        if self._line != self._printed:
            say(self._line)


class _Rate:
    """Units per second since this run began, without units from an interrupted run."""

    def __init__(self, done: int):
        self._before, self._start = done, time.monotonic()

    def __call__(self, done: int) -> float:
        return max(done - self._before, 0) / max(time.monotonic() - self._start, 1e-9)


def _format(figures: dict[str, Any]) -> str:
    return "".join(
        f", {name} {value:.3g}" if isinstance(value, float) else f", {name} {value}" for name, value in figures.items()
    )


@contextmanager
def _rich_bar(description: str, total: int, unit: str, done: int) -> Iterator[Bar]:
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
        task = progress.add_task(description, total=total, completed=done, figures="", rate="")
        rate = _Rate(done)

        class RichBar(Bar):
            def update(self, done: int, **figures: Any) -> None:
                shown = _format(figures).removeprefix(", ")
                progress.update(task, completed=done, rate=f"{rate(done):.1f}/s", figures=shown)

        yield RichBar()
