"""Tables, and their Markdown; the page's template makes HTML of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from stages.reporting.environment_runs import EnvironmentSummary
from stages.reporting.summary import Summary
from stages.runtime.terminal import one_line

UNKNOWN = "\N{EN DASH}"
WORDS = ("task", "environment", "method")
SUMMARY_HEADS = (
    "task",
    "method",
    "runs",
    "success rate, paper's criterion [95%]",
    "success rate in the paper",
    "success rate of deterministic episodes",
    "normalized final distance [95%]",
    "samples per run",
    "learning minutes per run",
    "translator minutes",
)
ENVIRONMENT_HEADS = (
    "environment",
    "method",
    "runs",
    "success rate [95%]",
    "success rate of deterministic episodes",
    "return [95%]",
    "samples per run",
    "learning minutes per run",
    "translator minutes",
)


@dataclass(frozen=True)
class Table:
    """Column heads, and rows with one unescaped text per head."""

    heads: tuple[str, ...]
    rows: list[tuple[str, ...]]

    @property
    def words(self) -> tuple[str, ...]:
        """Heads of the text columns; the other columns hold figures, which are right-aligned."""
        return WORDS

    def markdown(self) -> str:
        """The table in Markdown; no text breaks out of its cell."""
        marks = ["---" if head in WORDS else "---:" for head in self.heads]
        lines = [[in_markdown(text) for text in self.heads], marks]
        lines += [[in_markdown(text) for text in row] for row in self.rows]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def summary_table(summaries: Sequence[Summary]) -> Table:
    """Success by task and method, beside the paper's rates."""
    return Table(SUMMARY_HEADS, [_summary_row(item) for item in summaries])


def environment_table(summaries: Sequence[EnvironmentSummary]) -> Table:
    """Success rate and return by environment and method."""
    return Table(ENVIRONMENT_HEADS, [_environment_row(item) for item in summaries])


def in_markdown(text: str) -> str:
    """A text on one line, escaped so that Markdown reads no HTML, link or end of a cell in it."""
    plain = escape(one_line(" ".join(text.split())), quote=False).replace("\\", "\\\\")
    return plain.replace("](", "]\\(").replace("|", "\\|")


def _summary_row(item: Summary) -> tuple[str, ...]:
    low, high = item.success_interval
    return (
        item.task,
        item.method,
        str(len(item.runs)),
        f"{item.success:.2f} [{low:.2f}, {high:.2f}]",
        _known(item.paper, ".2f"),
        f"{item.deterministic:.2f}",
        f"{item.distance:.3f}{_spread(item.distance_interval, len(item.runs), '.3f')}",
        *_costs(item),
    )


def _environment_row(item: EnvironmentSummary) -> tuple[str, ...]:
    count = len(item.runs)
    rate = "" if item.success_interval is None else _spread(item.success_interval, count, ".2f")
    return (
        item.task,
        item.method,
        str(count),
        _known(item.success, ".2f") + rate,
        _known(item.deterministic, ".2f"),
        f"{item.env_return:.4g}{_spread(item.return_interval, count, '.4g')}",
        *_costs(item),
    )


def _spread(interval: tuple[float, float], runs: int, form: str) -> str:
    """An interval over runs in brackets; a single run has none."""
    low, high = interval
    return f" [{low:{form}}, {high:{form}}]" if runs > 1 else ""


def _costs(item: Summary | EnvironmentSummary) -> tuple[str, str, str]:
    return f"{item.samples:,.0f}", f"{item.learning_minutes:.1f}", _known(item.translator_minutes, ".0f")


def _known(value: float | None, form: str) -> str:
    return UNKNOWN if value is None else format(value, form)
