"""The report as one HTML page that needs no other file, and as Markdown."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from stages.reporting.lineage import Lineage
from stages.reporting.tables import Table, in_markdown
from stages.reporting.videos import Video

if TYPE_CHECKING:
    from jinja2 import Environment

MARK = "<!-- made by ifo report -->"  # first line of the Markdown: a file without it is somebody's own

HEADINGS = {"success": "Success by task and method", "curves": "Learning curves", "ablations": "Ablations"}
CAPTIONS = {
    "success": "Runs that succeed by the paper's criterion. Lines: Wilson's 95% interval.",
    "curves": (
        "Distance left over samples: mean over runs (how many, in brackets), the band its standard error. A run that "
        "ended early keeps its last distance."
    ),
    "ablations": "The method, and what departs from it: terms of its reward, or losses of its translator, left out.",
}
CRITERION = (
    "A run succeeds by the paper's criterion when the mean distance that its stochastic policy leaves, as a part of "
    "the distance at the start, is below the task's threshold. Brackets are 95% intervals: Wilson's for the success "
    "of runs, the bootstrap's over runs for the distance left. Samples and minutes are means over runs."
)


def page(
    title: str,
    origin: str,
    table: Table,
    plots: dict[str, bytes],
    videos: Sequence[Video],
    lineages: Sequence[Lineage],
    notes: Sequence[str],
) -> str:
    """The report as one HTML page. No text needs to be escaped before.

    Args:
        title: Its heading.
        origin: What it was made from, when and by what command.
        table: Success by task and method.
        plots: PNGs, by the names in `HEADINGS`.
        videos: In the order in which they are shown.
        lineages: One section per evaluation.
        notes: What the reader must know of what is not shown.
    """
    by_task: dict[str, list[Video]] = {}
    for video in videos:
        by_task.setdefault(video.task, []).append(video)
    return (
        _templates()
        .get_template("page.html")
        .render(
            title=title,
            origin=origin,
            criterion=CRITERION,
            table=table,
            plots=[{"heading": HEADINGS[name], "caption": CAPTIONS[name], "png": png} for name, png in plots.items()],
            videos=by_task,
            lineages=lineages,
            notes=notes,
        )
    )


def _templates() -> Environment:
    """The page's templates; whatever they are given is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("stages.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode()
    return environment


def markdown(
    title: str, origin: str, table: Table, plots: dict[str, Path], videos: Sequence[Video], notes: Sequence[str]
) -> str:
    """The tables, and links to the plots, which lie beside it."""
    lines = [MARK, "", f"# {in_markdown(title)}", "", in_markdown(origin), "", table.markdown(), "", CRITERION]
    for name, path in plots.items():
        # Angle brackets: the file's name may hold spaces.
        lines += ["", f"## {HEADINGS[name]}", "", CAPTIONS[name], "", f"![{HEADINGS[name]}](<{path.name}>)"]
    if videos:
        lines += ["", "## Videos", "", *(f"- {in_markdown(f'{v.task}: {v.title}: {v.path}')}" for v in videos)]
    if notes:
        lines += ["", "## Notes", "", *(f"- {in_markdown(note)}" for note in notes)]
    return "\n".join([*lines, ""])
