"""The report as one self-contained HTML page, and as Markdown; the page of one artifact."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stages.reporting.lineage import AncestorEntry, Lineage
from stages.reporting.tables import Table, in_markdown
from stages.reporting.videos import Video
from stages.runtime.terminal import one_line

if TYPE_CHECKING:
    from jinja2 import Environment

MARK = "<!-- made by ifo report -->"  # first line of the Markdown: a file without it is not overwritten

VIEWER = "ifo view"
HEAD = 1000  # bytes at the start of a page, which contain GENERATOR
GENERATOR = f'<meta name="generator" content="{VIEWER}">'  # in a page's head: a file without it is not overwritten

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


@dataclass(frozen=True)
class Section:
    """A section of a page: a table with how to read it, a plot or picture (PNG) with its caption, or both."""

    heading: str
    caption: str = ""
    png: bytes | None = None
    table: Table | None = None
    criterion: str = ""


@dataclass(frozen=True)
class View:
    """What the page of one artifact shows. The texts are not escaped.

    Attributes:
        title: Its heading, the file's name.
        origin: When and by what the page was made.
        sentence: What the artifact is.
        figures: Key figures, as texts.
        sections: Tables, plots and pictures.
        videos: In the order in which they are shown.
        notes: What the reader must know of what is not shown.
        origins: Command, seed, digest and the like of the file.
        ancestors: The files that it was made from.
        config: Its configuration, as texts.
    """

    title: str
    origin: str
    sentence: str
    figures: dict[str, str]
    sections: list[Section]
    videos: list[Video]
    notes: list[str]
    origins: dict[str, str]
    ancestors: list[AncestorEntry]
    config: dict[str, str]


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
    return _rendered(
        "page.html",
        generator="ifo report",
        title=title,
        origin=origin,
        sections=sections_of(tables, plots),
        videos=by_task,
        lineages=lineages,
        notes=notes,
    )


def view_page(view: View) -> str:
    """One artifact as one HTML page. No text needs to be escaped before."""
    return _rendered("view.html", generator=VIEWER, **{item.name: getattr(view, item.name) for item in fields(view)})


def made_by_view(data: bytes) -> bool:
    """Whether a file that starts with `data` is a page of `view_page`."""
    head, found, _ = data.partition(GENERATOR.encode())
    return bool(found) and head.startswith(b"<!doctype html>\n") and b"<body" not in head


def sections_of(tables: Mapping[str, Table], plots: Mapping[str, bytes]) -> list[Section]:
    """Sections in their order, from tables by the names in `CRITERIA` and plots (PNGs) by the names in `HEADINGS`."""
    return [
        Section(HEADINGS[name], CAPTIONS[name], plots.get(name), tables.get(name), CRITERIA.get(name, ""))
        for name in HEADINGS
        if name in tables or name in plots
    ]


def _rendered(template: str, **values: Any) -> str:
    return _templates().get_template(template).render(**values)


def _templates() -> Environment:
    """The templates of pages; whatever they are given is escaped, for HTML and where it is not printable."""
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
