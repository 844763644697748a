"""What every stage's command does: settle what was left open, run the stage, print one line."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import shlex
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from artifacts.errors import IfoError, PlatformError, UsageError
from artifacts.pipeline import STAGE_FILES
from ifo_cli.options import Given
from ifo_cli.streams import emit, inputs_or_stdin, plain, stdout_to_stderr
from stages.config.presets import PRESETS, defaults
from stages.config.task_names import permission_needed

if TYPE_CHECKING:
    from artifacts import Artifact
    from stages.runtime.processes import Processes
    from stages.runtime.run import RunOptions, StageResult

SHARED = ("train-translator",)  # stages whose work several processes can share
# Stages that run without permission to import the task; those after them need it (IFO_TASKS).
WITHOUT_PERMISSION = ("train-expert", "collect-demos", "train-translator")

Call = Callable[[Any, "RunOptions", list[Path]], "StageResult"]


def run_stage(
    stage: str,
    given: Given,
    call: Call,
    *,
    named: Sequence[Path] | None,
    several: bool = False,
    task: str = "",
) -> None:
    """Run a stage and print its artifact's path, or with --json its figures; of several processes, the main one does.

    Args:
        stage: Name of the stage.
        given: What the command line said.
        call: Calls the stage with its configuration, run options and input paths.
        named: Input paths of the command line; empty: read them from standard input; None: there are none.
        several: Whether the stage takes more than one input.
        task: The task that the command line named; else the first input's.
    """
    from stages.runtime.processes import OtherFailed, join

    try:
        with stdout_to_stderr():
            processes = join(stage, given.run.get("device", "auto"), stage in SHARED)
    except OtherFailed:
        return
    try:
        _run(stage, given, call, processes, named=named, several=several, task=task)
    except IfoError as error:
        if processes.failed(error):
            raise


def _run(
    stage: str,
    given: Given,
    call: Call,
    processes: Processes,
    *,
    named: Sequence[Path] | None,
    several: bool,
    task: str,
) -> None:
    _check_numbers(given)
    out = check_out(given.run.get("out"))
    if named is None:
        paths = []
    else:
        kind = STAGE_FILES[stage].reads
        if not named and processes.count > 1:
            raise UsageError(f"several processes share no standard input: name the {kind} artifact (NAME.{kind}.h5)")
        paths = inputs_or_stdin(named, f"the {kind} artifact (NAME.{kind}.h5)", several=several)
    if out is not None and any(_same_file(path, out) for path in paths):
        raise UsageError(f"--out {out} would replace the stage's own input: choose another name")
    words = [*given.words, *(() if named else map(str, paths))]
    with stdout_to_stderr():
        from artifacts import read_artifact
        from stages.runtime.progress import Progress
        from stages.runtime.run import RunOptions

        parents = [read_artifact(path, STAGE_FILES[stage].reads) for path in paths]
        run = RunOptions(
            **{**_inherited(parents), **given.run},
            command=shlex.join(["ifo", *words]),
            progress=Progress(quiet=given.quiet or not processes.main),
            processes=processes,
        )
        task = task or (str(parents[0].config.get("task") or "") if parents else "")
        if stage in WITHOUT_PERMISSION and (note := permission_needed(task)):
            run.progress.say(note)
        choice = given.config.get("learner") or given.config.get("arch") or ""
        config = dataclasses.replace(defaults(run.preset, stage, task, choice), **given.config)
        made = make_folder(out) if processes.main else []
        try:
            result = call(config, run, paths)
        except UsageError:
            with suppress(OSError):  # What diverged on the way has left its curve there.
                for folder in made:
                    folder.rmdir()
            raise
    if not processes.main:
        return
    if given.json:
        emit(json.dumps({"path": str(result.path), "kind": STAGE_FILES[stage].writes, **plain(result.summary)}))
    else:
        emit(str(result.path))


def _inherited(parents: Sequence[Artifact]) -> dict[str, Any]:
    """Preset and seed of the first parent."""
    if not parents:
        return {}
    manifest = parents[0].manifest
    preset = manifest.config.get("preset")
    return {"seed": manifest.seed, **({"preset": preset} if preset in PRESETS else {})}


def _check_numbers(given: Given) -> None:
    for name, value in given.config.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise UsageError(f"--{name.replace('_', '-')} {value}: expected a finite number")


def check_out(out: Path | None) -> Path | None:
    """Return --out, or raise UsageError where it is no name of an artifact."""
    if out is None:
        return None
    if out.suffix != ".h5" or out.name.endswith(".checkpoint.h5"):
        raise UsageError(f"--out {out}: expected a file name ending in .h5, by custom NAME.KIND.h5")
    if out.is_dir():
        raise UsageError(f"--out {out} is a folder: expected a file name ending in .h5")
    return out


def make_folder(out: Path | None) -> list[Path]:
    """Make the folder of `out`; returns the folders that this made, innermost first."""
    if out is None:
        return []
    missing = [folder for folder in out.parents if not folder.exists()]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PlatformError(f"--out {out}: its folder cannot be made ({error.strerror})") from error
    if not os.access(out.parent, os.W_OK | os.X_OK):
        raise PlatformError(f"--out {out}: its folder cannot be written: choose another place")
    return missing


def _same_file(path: Path, out: Path) -> bool:
    return path.resolve() == out.resolve()
