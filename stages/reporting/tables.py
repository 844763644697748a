"""Tables, and their Markdown; the page's template makes HTML of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from stages.reporting.summary import Summary
from stages.runtime.terminal import one_line

UNKNOWN = "\N{EN DASH}"
WORDS = ("task", "method")
SUMMARY_HEADS = (
    *WORDS,
    "runs",
    "success rate, paper's criterion [95%]",
    "success rate in the paper",
    "success rate of deterministic episodes",
    "normalized final distance [95%]",
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


def in_markdown(text: str) -> str:
    """A text on one line, escaped so that Markdown reads no HTML, link or end of a cell in it."""
    plain = escape(one_line(" ".join(text.split())), quote=False).replace("\\", "\\\\")
    return plain.replace("](", "]\\(").replace("|", "\\|")


def _summary_row(item: Summary) -> tuple[str, ...]:
    low, high = item.success_interval
    near, far = item.distance_interval
    # A single run has no spread over runs.
    distance_interval = f" [{near:.3f}, {far:.3f}]" if len(item.runs) > 1 else ""
    return (
        item.task,
        item.method,
        str(len(item.runs)),
        f"{item.success:.2f} [{low:.2f}, {high:.2f}]",
        _known(item.paper, ".2f"),
        f"{item.deterministic:.2f}",
        f"{item.distance:.3f}{distance_interval}",
        f"{item.samples:,.0f}",
        f"{item.learning_minutes:.1f}",
        _known(item.translator_minutes, ".0f"),
    )


def _known(value: float | None, form: str) -> str:
    return UNKNOWN if value is None else format(value, form)
