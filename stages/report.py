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
from stages.reporting.environment_runs import (
    EnvironmentSummary,
    environments_as_csv,
    read_environment_runs,
    summarise_environments,
)
from stages.reporting.lineage import lineage
from stages.reporting.names import DEMONSTRATIONS, TRANSLATOR
from stages.reporting.page import MARK, markdown, page
from stages.reporting.plots import draw, draw_environments
from stages.reporting.records import of_environment
from stages.reporting.rows import PolicyRun, as_csv, read_runs
from stages.reporting.summary import Summary, summarise
from stages.reporting.tables import environment_table, summary_table
from stages.reporting.videos import collect_videos
from stages.runtime.progress import Progress
from stages.runtime.run import StageResult

ENDING = ".evaluation.h5"


def report(inputs: Sequence[Path], out: Path, title: str, command: str, progress: Progress) -> StageResult:
    """Write the page and, next to it, with the same stem, the runs as CSV, the tables as Markdown, the plots as PNGs.

    Runs in Gymnasium environments have a table and a CSV (NAME-environments.csv) of their own.

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
    beside = _environments_csv(out)
    evaluations = [read_artifact(path, "evaluation") for path in find_evaluations(inputs)]
    read = [run for artifact in evaluations if not of_environment(artifact) for run in read_runs(artifact)]
    foreign = [run for artifact in evaluations if of_environment(artifact) for run in read_environment_runs(artifact)]
    runs, duplicates = count_once(read)
    environment_runs, more = count_once(foreign)
    duplicates += more
    for line in _repeated(duplicates):
        progress.say(line)
    if environment_runs and os.path.lexists(beside) and not _is_ours(beside):
        raise UsageError(f"--out {out} would replace {beside}, which `ifo report` did not write: choose another name")
    summaries, environments = summarise(runs), summarise_environments(environment_runs)
    # In the order of the tables.
    runs = [run for item in summaries for run in item.runs]
    environment_runs = [run for item in environments for run in item.runs]
    counted: list[PolicyRun] = [*runs, *environment_runs]
    ordered = list(dict.fromkeys(run.evaluation for run in counted))
    videos = collect_videos(ordered, counted)
    notes = [*_repeated(duplicates), *_without_curves(counted), *_unknown(counted), *videos.notes]
    plots = (draw(summaries) if summaries else {}) | (draw_environments(environments) if environments else {})
    files = {name: out.with_name(f"{out.stem}-{name}.png") for name in plots}
    tables = {"success": summary_table(summaries)} if summaries else {}
    if environments:
        tables["environments"] = environment_table(environments)
    origin = (
        f"Runs: {len(counted)}, of evaluation artifacts: {len(evaluations)}. "
        f"Made on {datetime.now(UTC).isoformat(timespec='seconds')} by: {command}"
    )
    lineages = [
        lineage(
            artifact,
            f"evaluation-{number}",
            [run for run in counted if run.evaluation is artifact],
            [item for item in duplicates if item.run.evaluation is artifact],
        )
        for number, artifact in enumerate([*ordered, *(a for a in evaluations if a not in ordered)], 1)
    ]
    whole = page(title, origin, tables, plots, videos.shown, lineages, notes)
    # The Markdown first: its mark allows a later report to replace the files. The page last: it is the result.
    text = markdown(title, origin, tables, files, videos.shown, notes)
    write_bytes(out.with_suffix(".md"), _encoded(text))
    write_bytes(out.with_suffix(".csv"), _encoded(as_csv(runs)))
    if environment_runs:
        write_bytes(beside, _encoded(environments_as_csv(environment_runs)))
    elif _is_ours(beside):
        beside.unlink()  # Of an earlier report, whose environments are not on this page.
    for name, png in plots.items():
        write_bytes(files[name], png)
    write_bytes(out, _encoded(whole))
    progress.say(f"report: runs {len(counted)}, videos {len(videos.shown)}, {out.stat().st_size / 1e6:.1f} MB")
    figures = _figures(summaries, evaluations, duplicates)
    return StageResult(out, figures | ({"environments": _environment_figures(environments)} if environments else {}))


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


def _environments_csv(out: Path) -> Path:
    return out.with_name(f"{out.stem}-environments.csv")


def _is_ours(path: Path) -> bool:
    """Whether there is a CSV of runs in environments at `path`."""
    head = environments_as_csv([]).encode()
    try:
        with open(path, "rb") as file:
            return file.read(len(head)) == head
    except OSError:
        return False


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


def _without_curves(runs: Sequence[PolicyRun]) -> list[str]:
    paths = dict.fromkeys(str(run.evaluation.path) for run in runs if not run.samples_curve.size)
    return [f"Evaluations by an older ifo, without learning curves: {', '.join(paths)}."] if paths else []


def _unknown(runs: Sequence[PolicyRun]) -> list[str]:
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


def _environment_figures(summaries: Sequence[EnvironmentSummary]) -> list[dict[str, Any]]:
    return [
        {
            "environment": item.task,
            "method": item.method,
            "runs": len(item.runs),
            "success": item.success,
            "success_interval": item.success_interval,
            "success_deterministic": item.deterministic,
            "env_return": item.env_return,
            "env_return_interval": item.return_interval,
            "samples": item.samples,
            "learning_minutes": item.learning_minutes,
            "translator_minutes": item.translator_minutes,
        }
        for item in summaries
    ]


def _encoded(text: str) -> bytes:
    # File names that are not valid UTF-8 stay readable.
    return text.encode("utf-8", "backslashreplace")
