"""The report as one self-contained HTML page, and as Markdown."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stages.reporting.lineage import Lineage
from stages.reporting.tables import Table, in_markdown
from stages.reporting.videos import Video
from stages.runtime.terminal import one_line

if TYPE_CHECKING:
    from jinja2 import Environment

MARK = "<!-- made by ifo report -->"  # first line of the Markdown: a file without it is not overwritten

# Sections in their order; each has a table, a plot or both.
HEADINGS = {
    "success": "Success by task and method",
    "curves": "Learning curves",
    "ablations": "Ablations",
    "environments": "Success by environment and method",
    "environment-curves": "Learning curves in environments",
}
CAPTIONS = {
    "success": "Success rates by the paper's criterion. Lines: 95% Wilson intervals.",
    "curves": (
        "Normalized final distance over samples: mean over runs (their number in brackets) and its standard error "
        "(band). A run that ended early keeps its last distance."
    ),
    "ablations": "The method and its ablations: without a term of the reward or a loss of the translator.",
    "environments": "Success rates of episodes. Lines: 95% bootstrap intervals over runs (their number in brackets).",
    "environment-curves": (
        "Success rate, or return of the environment's own reward, over samples: mean over runs (their number in "
        "brackets) and its standard error (band)."
    ),
}
CRITERIA = {  # how to read a section's table
    "success": (
        "A run succeeds by the paper's criterion if the mean normalized final distance of its stochastic policy (final "
        "distance / initial distance) is below the task's threshold. Brackets are 95% intervals: Wilson for the "
        "success rate, bootstrap over runs for the distance. Samples and minutes are means over runs."
    ),
    "environments": (
        "Success is reported by the environment, or by the function given with --success. Success rates and returns of "
        "the environment's own reward are means over the episodes of the stochastic policies, then over runs; brackets "
        "are 95% bootstrap intervals over runs."
    ),
}


def page(
    title: str,
    origin: str,
    tables: Mapping[str, Table],
    plots: Mapping[str, bytes],
    videos: Sequence[Video],
    lineages: Sequence[Lineage],
    notes: Sequence[str],
) -> str:
    """The report as one HTML page. No text needs to be escaped before.

    Args:
        title: Its heading.
        origin: What it was made from, when and by what command.
        tables: Tables, by the names in `CRITERIA`.
        plots: PNGs, by the names in `HEADINGS`.
        videos: In the order in which they are shown.
        lineages: One section per evaluation.
        notes: What the reader must know of what is not shown.
    """
    by_task: dict[str, list[Video]] = {}
    for video in videos:
        by_task.setdefault(video.task, []).append(video)
    sections = [
        {
            "heading": HEADINGS[name],
            "table": tables.get(name),
            "criterion": CRITERIA.get(name, ""),
            "caption": CAPTIONS[name],
            "png": plots.get(name),
        }
        for name in HEADINGS
        if name in tables or name in plots
    ]
    return (
        _templates()
        .get_template("page.html")
        .render(title=title, origin=origin, sections=sections, videos=by_task, lineages=lineages, notes=notes)
    )


def _templates() -> Environment:
    """The page's templates; whatever they are given is escaped, for HTML and where it is not printable."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("stages.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_printable,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode()
    return environment


def _printable(value: Any) -> Any:
    # HTML that macros return is left as it is.
    return one_line(value) if isinstance(value, str) and not hasattr(value, "__html__") else value


def markdown(
    title: str,
    origin: str,
    tables: Mapping[str, Table],
    plots: Mapping[str, Path],
    videos: Sequence[Video],
    notes: Sequence[str],
) -> str:
    """The report as Markdown: the tables, and links to the plots beside it."""
    lines = [MARK, "", f"# {in_markdown(title)}", "", in_markdown(origin)]
    for name, table in tables.items():
        lines += ["", table.markdown(), "", CRITERIA[name]]
    for name, path in plots.items():
        # Angle brackets: the file name may contain spaces.
        lines += ["", f"## {HEADINGS[name]}", "", CAPTIONS[name], "", f"![{HEADINGS[name]}](<{path.name}>)"]
    if videos:
        lines += ["", "## Videos", "", *(f"- {in_markdown(f'{v.task}: {v.title}: {v.path}')}" for v in videos)]
    if notes:
        lines += ["", "## Notes", "", *(f"- {in_markdown(note)}" for note in notes)]
    return "\n".join([*lines, ""])
