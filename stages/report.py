"""report: the results of evaluations on one page that opens in any browser, with the origin of every number."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from artifacts import Artifact, ArtifactError, PlatformError, UsageError, read_artifact
from artifacts.atomic import write_bytes
from artifacts.paths import files_below, real
from stages.reporting.counting import Duplicate, count_once
from stages.reporting.lineage import lineage
from stages.reporting.names import DEMONSTRATIONS, TRANSLATOR
from stages.reporting.page import MARK, markdown, page
from stages.reporting.plots import draw
from stages.reporting.rows import Run, as_csv, of_environment, read_runs
from stages.reporting.summary import Summary, summarise
from stages.reporting.tables import summary_table
from stages.reporting.videos import collect_videos
from stages.runtime.progress import Progress
from stages.runtime.run import StageResult

ENDING = ".evaluation.h5"


def report(inputs: Sequence[Path], out: Path, title: str, command: str, progress: Progress) -> StageResult:
    """Write the page and, next to it, the runs as CSV, the table as Markdown and the plots as PNGs, with the same stem.

    Args:
        inputs: Evaluation artifacts, and folders to search for them.
        out: The page, NAME.html.
        title: Its heading.
        command: The command line, shown on the page.
        progress: Prints messages.

    Raises:
        ArtifactError: An input is not an evaluation, is damaged, or is a folder without any. Nothing is written.
        UsageError: A file that would be replaced was not written by `ifo report`. Nothing is written.
    """
    _check_replaceable(out)
    found = [read_artifact(path, "evaluation") for path in find_evaluations(inputs)]
    evaluations = [artifact for artifact in found if not of_environment(artifact)]
    if not evaluations:
        raise ArtifactError(
            f"{found[0].path}: is of a Gymnasium environment, and reports cover simulated tasks only: see its key "
            "figures with ifo inspect"
        )
    left_out = [
        f"Of Gymnasium environments, and not shown: {artifact.path}."
        for artifact in found
        if artifact not in evaluations
    ]
    for line in left_out:
        progress.say(line)
    runs, duplicates = count_once([run for artifact in evaluations for run in read_runs(artifact)])
    for line in _repeated(duplicates):
        progress.say(line)
    summaries = summarise(runs)
    runs = [run for item in summaries for run in item.runs]  # in the order of the table
    ordered = list(dict.fromkeys(run.evaluation for run in runs))
    videos = collect_videos(ordered, runs)
    notes = [*left_out, *_repeated(duplicates), *_without_curves(runs), *_unknown(runs), *videos.notes]
    plots = draw(summaries)
    files = {name: out.with_name(f"{out.stem}-{name}.png") for name in plots}
    table = summary_table(summaries)
    origin = (
        f"Runs: {len(runs)}, of evaluation artifacts: {len(evaluations)}. "
        f"Made on {datetime.now(UTC).isoformat(timespec='seconds')} by: {command}"
    )
    lineages = [
        lineage(
            artifact,
            f"evaluation-{number}",
            [run for run in runs if run.evaluation is artifact],
            [item for item in duplicates if item.run.evaluation is artifact],
        )
        for number, artifact in enumerate([*ordered, *(a for a in evaluations if a not in ordered)], 1)
    ]
    whole = page(title, origin, table, plots, videos.shown, lineages, notes)
    # The Markdown first: its mark allows a later report to replace the files. The page last: it is the result.
    text = markdown(title, origin, table, files, videos.shown, notes)
    write_bytes(out.with_suffix(".md"), _encoded(text))
    write_bytes(out.with_suffix(".csv"), _encoded(as_csv(runs)))
    for name, png in plots.items():
        write_bytes(files[name], png)
    write_bytes(out, _encoded(whole))
    progress.say(f"report: runs {len(runs)}, videos {len(videos.shown)}, {out.stat().st_size / 1e6:.1f} MB")
    return StageResult(out, _figures(summaries, evaluations, duplicates))


def find_evaluations(inputs: Sequence[Path]) -> list[Path]:
    """The given files, and the evaluations in given folders, each once.

    Raises:
        ArtifactError: A folder contains none.
    """
    found: dict[Path, Path] = {}
    for path in inputs:
        if os.path.isdir(path):
            inside = files_below(path, ENDING)
            if not inside:
                raise ArtifactError(f"{path}: contains no evaluation (*{ENDING}): create one with `ifo evaluate`")
        else:
            inside = [path]
        for file in inside:
            found.setdefault(real(file), file)
    return list(found.values())


def _check_replaceable(out: Path) -> None:
    """Refuse to replace files that are not a report's, for example README.md with --out README.html."""
    beside = [out.with_suffix(".md"), out.with_suffix(".csv")]
    if os.path.isfile(beside[0]):
        try:
            with open(beside[0], "rb") as file:
                if file.read(len(MARK)) == MARK.encode():
                    return
        except OSError as error:
            raise PlatformError(f"{beside[0]}: cannot be read ({error.strerror}): choose another --out") from error
    for path in beside:
        if os.path.lexists(path):
            raise UsageError(f"--out {out} would replace {path}, which `ifo report` did not write: choose another name")


def _repeated(duplicates: Sequence[Duplicate]) -> list[str]:
    """One line per pair of evaluations that share runs."""
    shared: dict[tuple[Path, Path], list[str]] = {}
    for item in duplicates:
        pair = item.run.evaluation.path, item.kept.evaluation.path
        shared.setdefault(pair, []).append(item.run.name)
    return [
        f"Runs in both {left_out} and {kept} that are counted once: {', '.join(names)}."
        for (left_out, kept), names in shared.items()
    ]


def _without_curves(runs: Sequence[Run]) -> list[str]:
    paths = dict.fromkeys(str(run.evaluation.path) for run in runs if not run.samples_curve.size)
    return [f"Evaluations by an older ifo, without learning curves: {', '.join(paths)}."] if paths else []


def _unknown(runs: Sequence[Run]) -> list[str]:
    """One line per kind of input file that evaluations could not identify."""
    notes = []
    for part in (TRANSLATOR, DEMONSTRATIONS):
        paths = dict.fromkeys(str(run.evaluation.path) for run in runs if run.unknown == part)
        if paths:
            notes.append(
                f"{part.capitalize()} unknown, because files were missing or had changed when the policies were "
                "evaluated, or because an older ifo did not record it (put the files back and run `ifo evaluate "
                f"--overwrite`): {', '.join(paths)}."
            )
    return notes


def _figures(
    summaries: Sequence[Summary], evaluations: Sequence[Artifact], duplicates: Sequence[Duplicate]
) -> dict[str, Any]:
    rows = [
        {
            "task": item.task,
            "method": item.method,
            "runs": len(item.runs),
            "succeeded": item.succeeded,
            "success_paper": item.success,
            "success_paper_interval": item.success_interval,
            "success_deterministic": item.deterministic,
            "normalised_distance": item.distance,
            "normalised_distance_interval": item.distance_interval,
            "samples": item.samples,
            "learning_minutes": item.learning_minutes,
            "translator_minutes": item.translator_minutes,
            "papers_own_success": item.paper,
        }
        for item in summaries
    ]
    return {"evaluations": len(evaluations), "duplicates": len(duplicates), "methods": rows}


def _encoded(text: str) -> bytes:
    # File names that are not valid UTF-8 stay readable.
    return text.encode("utf-8", "backslashreplace")
