"""The MP4s beside evaluations, and beside the translations that policies learned from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from artifacts import Artifact, ancestors, sibling
from stages.reporting.rows import Run

MOST_BYTES = 30 * 10**6  # of all videos of a page together
MOST_TRANSLATIONS = 4  # a task


@dataclass(frozen=True)
class Video:
    """An MP4 and what it shows."""

    task: str
    title: str
    path: Path
    data: bytes


@dataclass(frozen=True)
class Videos:
    """What a page shows, and one line for each thing that it does not."""

    shown: list[Video]
    notes: list[str]


def collect_videos(evaluations: Sequence[Artifact], runs: Sequence[Run]) -> Videos:
    """Read the videos of evaluations, then those of translations, until a page is full.

    Args:
        evaluations: In the order in which their videos are shown.
        runs: All that count.
    """
    shown: list[Video] = []
    missing, left_out = [], []
    total = 0
    wanted = [*_evaluation_videos(evaluations, runs), *_translation_videos(runs)]
    for task, title, path in wanted:
        try:
            size = path.stat().st_size
            if total + size > MOST_BYTES:
                left_out.append(path)
                continue
            data = path.read_bytes()
        except OSError:
            missing.append(path)
            continue
        total += len(data)
        shown.append(Video(task, title, path, data))
    notes = []
    if missing:
        notes.append(f"Videos that are not there: {_listed(missing)}.")
    if left_out:
        notes.append(f"Videos left out, to keep the page below {MOST_BYTES / 1e6:.0f} MB of them: {_listed(left_out)}.")
    return Videos(shown, notes)


def _evaluation_videos(evaluations: Sequence[Artifact], runs: Sequence[Run]) -> Iterator[tuple[str, str, Path]]:
    for artifact in evaluations:
        mine = [run for run in runs if run.evaluation is artifact]
        if mine:
            methods = ", ".join(dict.fromkeys(run.method for run in mine))
            title = f"What was learned ({methods}): the evaluation's first runs, an episode each"
            yield mine[0].task, title, sibling(artifact.path, ".mp4")


def _translation_videos(runs: Sequence[Run]) -> Iterator[tuple[str, str, Path]]:
    """Of each task the first few, each translation once; only those that its policies were learned from for sure."""
    found: dict[str, set[Path]] = {}
    for run in runs:
        if run.policy is None or not run.method.startswith("translation"):
            continue
        mine = found.setdefault(run.task, set())
        for item in ancestors(run.evaluation, [run.policy], check=True):
            if item.depth > 2 or len(mine) >= MOST_TRANSLATIONS:
                break
            path = sibling(item.path, ".mp4")
            if item.parent.kind == "translation" and item.artifact is not None and path not in mine:
                mine.add(path)
                title = f"Translation that {run.name} learned from, context {run.recorded['context_seed']}"
                yield run.task, title, path


def _listed(paths: Sequence[Path]) -> str:
    return ", ".join(map(str, paths))
