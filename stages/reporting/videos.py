"""The MP4s beside evaluations, and beside the translations that policies learned from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from artifacts import Artifact, ancestors, open_regular, sibling
from stages.reporting.rows import PolicyRun

MOST_BYTES = 30 * 10**6  # total size of the videos of a page
MOST_TRANSLATIONS = 4  # per task


@dataclass(frozen=True)
class Video:
    """An MP4 and what it shows; `path` is its file, None if there is none."""

    task: str
    title: str
    path: Path | None
    data: bytes


@dataclass(frozen=True)
class Videos:
    """The videos of a page, and one line on those that are not shown."""

    shown: list[Video]
    notes: list[str]


def collect_videos(evaluations: Sequence[Artifact], runs: Sequence[PolicyRun]) -> Videos:
    """Read the videos of evaluations, then those of translations, up to `MOST_BYTES`.

    Args:
        evaluations: In the order in which their videos are shown.
        runs: All runs that count.
    """
    return read_videos([*_evaluation_videos(evaluations, runs), *_translation_videos(runs)])


def read_videos(wanted: Iterable[tuple[str, str, Path]], total: int = 0) -> Videos:
    """Read MP4s, given as (task, title, path), up to `MOST_BYTES`, of which the page already holds `total`."""
    shown: list[Video] = []
    missing, left_out = [], []
    for task, title, path in wanted:
        try:
            size = path.stat().st_size
            if total + size > MOST_BYTES:
                left_out.append(path)
                continue
            with open_regular(path) as file:
                data = file.read(MOST_BYTES)
        except OSError:
            missing.append(path)
            continue
        total += len(data)
        shown.append(Video(task, title, path, data))
    notes = []
    if missing:
        notes.append(f"Missing videos: {_listed(missing)}.")
    if left_out:
        notes.append(
            f"Videos left out because a page holds at most {MOST_BYTES / 1e6:.0f} MB of videos: {_listed(left_out)}."
        )
    return Videos(shown, notes)


def _evaluation_videos(evaluations: Sequence[Artifact], runs: Sequence[PolicyRun]) -> Iterator[tuple[str, str, Path]]:
    for artifact in evaluations:
        mine = [run for run in runs if run.evaluation is artifact]
        if mine:
            methods = ", ".join(dict.fromkeys(run.method for run in mine))
            title = f"Learned policies ({methods}): one episode of each of the first runs"
            yield mine[0].task, title, sibling(artifact.path, ".mp4")


def _translation_videos(runs: Sequence[PolicyRun]) -> Iterator[tuple[str, str, Path]]:
    """The first few translations of each task, each once; only if unchanged since a policy was learned from them."""
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
                title = f"Translation that {run.name} learned from, context {run.seed_of_context}"
                yield run.task, title, path


def _listed(paths: Sequence[Path]) -> str:
    return ", ".join(map(str, paths))
