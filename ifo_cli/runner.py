"""Common code of the commands: resolve the options, run the stage, print one line."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from artifacts.errors import ArtifactError, IfoError, PlatformError, UsageError
from artifacts.pipeline import STAGE_FILES
from ifo_cli.options import Given
from ifo_cli.settling import Settled, check_at_once, read_file, settle, show
from ifo_cli.streams import emit, emit_path, inputs_or_stdin, plain, stdout_to_stderr
from stages.config.task_names import check_task_name, permission_needed
from stages.config.toml import Table

if TYPE_CHECKING:
    from artifacts import Artifact
    from stages.runtime.processes import Processes
    from stages.runtime.run import RunOptions, StageResult

SHARED = ("train-translator",)  # stages that several processes can run together

# Stages that run without permission to import the task. Later stages need permission (IFO_TASKS).
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
    """Run a stage and print its artifact's path, or with --json its figures. Only the main process prints.

    Args:
        stage: Name of the stage.
        given: The parsed command line.
        call: Calls the stage with its configuration, run options and input paths.
        named: Input paths on the command line; empty: read them from standard input; None: the stage has no input.
        several: Whether the stage accepts more than one input.
        task: Task named on the command line; empty: the task of the first input.
    """
    from stages.runtime.processes import OtherFailed, is_main, join

    try:
        table = read_file(given)
    except UsageError:
        if is_main():
            raise
        return
    if given.get("show_config"):
        if is_main():
            _show(stage, given, table, named or (), task)
        return
    try:
        with stdout_to_stderr():
            device = given.shared.get("device") or table.settings.get("device", "auto")
            processes = join(stage, device, stage in SHARED)
    except OtherFailed:
        return
    try:
        _run(stage, given, table, call, processes, named=named, several=several, task=task)
    except IfoError as error:
        if processes.failed(error):
            raise


def _show(stage: str, given: Given, table: Table, named: Sequence[Path], task: str) -> None:
    """Print the value of every option; standard input is not read."""
    with stdout_to_stderr():
        parents = _read(stage, named)
        settled = settle(given, table, parents, task or _task_of(parents), typed=bool(task))
    show(given, settled)


def _run(
    stage: str,
    given: Given,
    table: Table,
    call: Call,
    processes: Processes,
    *,
    named: Sequence[Path] | None,
    several: bool,
    task: str,
) -> None:
    out = check_out(given.get("out"))
    paths = _inputs(stage, given, table, processes, named, several)
    if out is not None and any(_same_file(path, out) for path in paths):
        raise UsageError(f"--out {out} would replace the stage's own input: choose another name")
    with stdout_to_stderr():
        from stages.runtime.progress import Progress
        from stages.runtime.run import RunOptions

        parents = _read(stage, paths)
        settled = settle(given, table, parents, task or _task_of(parents), typed=bool(task))
        run = RunOptions(
            **settled.settings,
            out=out,
            resume=given.get("resume"),
            overwrite=given.get("overwrite"),
            command=command_line(given, () if named else paths),
            progress=Progress(quiet=given.get("quiet") or not processes.main),
            processes=processes,
            given=settled.given,
        )
        if stage in WITHOUT_PERMISSION and (note := permission_needed(settled.task)):
            own = "" if settled.task_known else f"; until then its own defaults for {stage}, if any, are not used"
            run.progress.say(f"{note}{own}")
        made = make_folder(out) if processes.main else []
        try:
            result = call(settled.config, run, paths)
        except UsageError:
            with suppress(OSError):  # A run that diverged has left its learning curve there, so the folder is kept.
                for folder in made:
                    folder.rmdir()
            raise
    if processes.main:
        emit_result(given, result, STAGE_FILES[stage].writes)


def _inputs(
    stage: str,
    given: Given,
    table: Table,
    processes: Processes,
    named: Sequence[Path] | None,
    several: bool,
) -> list[Path]:
    """Return the paths of the stage's inputs, read from standard input if none is named."""
    if named is None:
        return []
    kind = STAGE_FILES[stage].reads
    if not named:
        if processes.count > 1:
            raise UsageError(
                f"several processes cannot share standard input: name the {kind} artifact (NAME.{kind}.h5)"
            )
        check_at_once(given, table)
    return inputs_or_stdin(named, f"the {kind} artifact (NAME.{kind}.h5)", several=several)


def _read(stage: str, paths: Sequence[Path]) -> list[Artifact]:
    from artifacts import read_artifact

    return [read_artifact(path, STAGE_FILES[stage].reads) for path in paths]


def _task_of(parents: Sequence[Artifact]) -> str:
    """Return the task that the first parent names.

    Raises:
        ArtifactError: There is no such task.
    """
    if parents and parents[0].config.get("environment"):
        return ""  # The learner lives in a Gymnasium environment, to which the task's own defaults do not apply.
    name = str(parents[0].config.get("task") or "") if parents else ""
    try:
        return check_task_name(name) if name else ""
    except UsageError as error:
        raise ArtifactError(f"{parents[0].path}: {error}") from error


def command_line(given: Given, piped: Sequence[Path] = ()) -> str:
    """Return the command as a user would type it, including the paths that came from standard input."""
    return shlex.join(["ifo", *given.words, *map(str, piped)])


def emit_result(given: Given, result: StageResult, kind: str) -> None:
    """Print the path of the file that was written, or with --json one object with the stage's figures."""
    try:
        if given.get("json"):
            emit(json.dumps({"path": str(result.path), "kind": kind, **plain(result.summary)}))
        else:
            emit_path(result.path)
    except PlatformError as error:
        raise PlatformError(f"{error}; {result.path} is complete") from error


def settled_alone(given: Given) -> Settled | None:
    """Resolve the options of a command without parents and presets; None: --show-config printed them."""
    settled = settle(given, read_file(given))
    if given.get("show_config"):
        show(given, settled)
        return None
    return settled


def check_out(out: Path | None) -> Path | None:
    """Return --out, or raise UsageError if it is not a valid name for an artifact."""
    if out is None:
        return None
    if out.suffix != ".h5" or out.name.endswith(".checkpoint.h5"):
        raise UsageError(f"--out {out}: expected a file name ending in .h5, by convention NAME.KIND.h5")
    if os.path.isdir(out):
        raise UsageError(f"--out {out} is a folder: expected a file name ending in .h5")
    return out


def make_folder(out: Path | None) -> list[Path]:
    """Create the folder of `out`, and return the folders that were created, innermost first."""
    if out is None:
        return []
    missing = [folder for folder in out.parents if not os.path.lexists(folder)]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PlatformError(f"--out {out}: cannot create its folder ({error.strerror})") from error
    if not os.access(out.parent, os.W_OK | os.X_OK):
        raise PlatformError(f"--out {out}: its folder is not writable: choose another location")
    target = os.path.realpath(out)
    if os.path.lexists(target) and not os.path.isfile(target):
        raise UsageError(f"--out {out}: is a pipe, a device or a link to itself: choose another name")
    return missing


def _same_file(path: Path, out: Path) -> bool:
    return os.path.realpath(path) == os.path.realpath(out)
