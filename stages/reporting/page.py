"""The report as one HTML page that needs no other file, and as Markdown."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from stages.reporting.tables import Table, in_markdown
from stages.reporting.videos import Video

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
STYLE = """
:root { color-scheme: light dark; --ink: #1c2024; --paper: #fff; --faint: #667; --line: #d5d9de; --shade: #f5f6f8; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e6e9; --paper: #16181b; --faint: #9aa3ad; --line: #3a3f45; --shade: #202327; }
}
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
  max-width: 1160px; margin: 2rem auto 4rem; padding: 0 1.2rem; }
h1 { font-size: 1.7rem; margin-bottom: .2rem; } h2 { font-size: 1.25rem; margin-top: 2.4rem; }
h3 { font-size: 1rem; margin: 1.4rem 0 .5rem; } h4 { font-size: .9rem; margin: .8rem 0 .3rem; }
.faint, figcaption { color: var(--faint); font-size: .87rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .84rem; font-variant-numeric: tabular-nums; width: 100%; }
th, td { padding: .35rem .5rem; border-bottom: 1px solid var(--line); text-align: left; vertical-align: bottom; }
th { font-weight: 600; line-height: 1.25; } .figure { text-align: right; } td { white-space: nowrap; }
figure { margin: 1rem 0; } figure img { max-width: 100%; background: #fff; border-radius: 6px; }
.videos { display: flex; flex-wrap: wrap; gap: 1rem; align-items: flex-end; }
.videos figure { margin: 0; max-width: 100%; flex: 0 1 auto; }
.videos video { max-width: 100%; max-height: 420px; display: block; border-radius: 6px; background: #fff; }
.videos figcaption { max-width: 26rem; margin-top: .3rem; overflow-wrap: anywhere; }
details { border: 1px solid var(--line); border-radius: 6px; margin: .5rem 0; padding: .45rem .8rem; }
details details { background: var(--shade); } summary { cursor: pointer; overflow-wrap: anywhere; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .1rem 1rem; margin: .4rem 0; font-size: .85rem; }
dt { color: var(--faint); } dd { margin: 0; overflow-wrap: anywhere; }
code { font-size: .82rem; overflow-wrap: anywhere; } .chain { padding-left: 1.3rem; } .chain li { margin: .5rem 0; }
.gone { color: #b3541e; font-size: .85rem; }
"""


def page(
    title: str,
    origin: str,
    table: Table,
    plots: dict[str, bytes],
    videos: Sequence[Video],
    lineages: Sequence[str],
    notes: Sequence[str],
) -> str:
    """The whole page.

    Args:
        title: Unescaped.
        origin: What it was made from, when and by what command, unescaped.
        table: Success by task and method.
        plots: PNGs, by the names in `HEADINGS`.
        videos: In the order in which they are shown.
        lineages: HTML, a section an evaluation.
        notes: What the reader must know of what is not there, unescaped.
    """
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="faint">{escape(origin)}</p>',
        f"<h2>{HEADINGS['success']}</h2>",
        table.html(),
        f'<p class="faint">{escape(CRITERION)}</p>',
        _plot("success", plots["success"]),
    ]
    for name in ("curves", "ablations"):
        if name in plots:
            parts += [f"<h2>{HEADINGS[name]}</h2>", _plot(name, plots[name])]
    if videos:
        parts += ["<h2>Videos</h2>", *_videos(videos)]
    if notes:
        parts += ["<h2>Notes</h2>", "<ul>", *(f"<li>{escape(note)}</li>" for note in notes), "</ul>"]
    parts += ["<h2>Where the numbers come from</h2>", *lineages]
    body = "\n".join(parts)
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<meta name="generator" '
        f'content="ifo report">\n<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n'
        f"<body>\n{body}\n</body>\n</html>\n"
    )


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


def _plot(name: str, png: bytes) -> str:
    source = f"data:image/png;base64,{base64.b64encode(png).decode()}"
    return f'<figure><img src="{source}" alt="{HEADINGS[name]}"><figcaption>{CAPTIONS[name]}</figcaption></figure>'


def _videos(videos: Sequence[Video]) -> list[str]:
    parts = []
    for task in dict.fromkeys(video.task for video in videos):
        parts += [f"<h3>{escape(task)}</h3>", '<div class="videos">']
        for video in (video for video in videos if video.task == task):
            source = f"data:video/mp4;base64,{base64.b64encode(video.data).decode()}"
            caption = f"{escape(video.title)} (<code>{escape(str(video.path))}</code>)"
            parts.append(
                f'<figure><video controls loop muted autoplay playsinline src="{source}"></video>'
                f"<figcaption>{caption}</figcaption></figure>"
            )
        parts.append("</div>")
    return parts
