"""reproduce: run the paper's comparisons and ablations as a Snakemake workflow over the other commands."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from artifacts import ArtifactError, Interrupted, PlatformError, UsageError
from artifacts.atomic import write_bytes
from stages.reproduction.plan import Grid, Job, plan, wanted
from stages.reproduction.times import longest_chain, memory, minutes
from stages.runtime.interrupts import killable
from stages.runtime.progress import Progress
from stages.runtime.run import StageResult

SNAKEFILE = Path(__file__).parent / "reproduction" / "Snakefile"
JOBS, LOCK, LOGS, CACHE = "jobs.json", ".reproduce.lock", "logs", ".snakemake/cache"
# Snakemake, whose own traceback is not shown if it is interrupted before it handles interrupts.
ENGINE = """
import sys
show = sys.excepthook
sys.excepthook = lambda kind, *error: sys.exit(130) if kind is KeyboardInterrupt else show(kind, *error)
from snakemake.cli import main
main()
"""
RETRIES = 1
RUNTIME = 6  # requested of a cluster: this many times the estimate, at least half an hour
MEGABYTE = 1 << 20


@dataclass(frozen=True)
class Execution:
    """How to run the jobs.

    Attributes:
        executor: `local`, or a Snakemake plugin: `slurm`, `kubernetes`.
        cores: Number of parallel jobs; each takes one core.
        command: The command line, shown after an interruption.
    """

    executor: str
    cores: int
    command: str


def reproduce(grid: Grid, folder: Path, execution: Execution, progress: Progress) -> StageResult:
    """Run the missing jobs of a grid in `folder`.

    A job that fails is tried once more; then it and its dependents are skipped, and the others go on. Jobs that were
    killed continue from their checkpoints.

    Raises:
        ArtifactError: Some runs failed; the message names them and their logs.
        Interrupted: The user stopped it.
        PlatformError: Snakemake or its plugin is missing, or the folder cannot be written.
        UsageError: Another process uses the folder.
    """
    _check(execution)
    jobs = plan(grid)
    with _alone(folder) as lock:
        todo = missing(jobs, folder)
        progress.say(described(todo, grid, execution.cores))
        if todo:
            write_bytes(folder / JOBS, json.dumps(_as_rules(jobs, grid.preset), indent=1).encode())
            _run(folder, execution, lock)
        left = missing(jobs, folder)
    if left:
        raise ArtifactError(_failed(left, wanted(jobs), folder))
    return StageResult(folder, {"runs": len(wanted(jobs)), "jobs": len(jobs), "made": len(todo)})


def missing(jobs: Sequence[Job], folder: Path) -> list[Job]:
    """The jobs that are still needed: their output is missing, and so is a wanted file that depends on it."""
    absent = [job for job in jobs if not os.path.exists(folder / job.output)]
    needed = {job.output for job in absent if job.stage == "evaluate"}
    for job in reversed(absent):  # Jobs come after their inputs.
        if job.output in needed:
            needed |= set(job.inputs)
    return [job for job in absent if job.output in needed]


def described(jobs: Sequence[Job], grid: Grid, cores: int) -> str:
    """A line with the number of jobs and their estimated time."""
    if not jobs:
        return "reproduce: nothing to do, all files exist"
    counts = Counter(job.stage for job in jobs)
    total = sum(minutes(job, grid.preset) for job in jobs)
    wall = max(total / cores, longest_chain(list(jobs), grid.preset))
    kinds = ", ".join(f"{count} {stage}" for stage, count in counts.items())
    return f"reproduce: {len(jobs)} jobs ({kinds}), about {_hours(total)} on one core, {_hours(wall)} on {cores}"


def _hours(spent: float) -> str:
    return f"{spent / 60:.1f} hours" if spent >= 90 else f"{spent:.0f} minutes"


def _as_rules(jobs: Sequence[Job], preset: str) -> list[dict[str, Any]]:
    last = set(wanted(jobs))
    return [
        {
            "name": job.name,
            "inputs": job.inputs,
            "output": job.output,
            "command": job.command,
            "memory": memory(job),
            "runtime": max(30, round(RUNTIME * minutes(job, preset))),
            "wanted": job in last,
        }
        for job in jobs
    ]


def _check(execution: Execution) -> None:
    if find_spec("snakemake") is None:
        raise PlatformError("ifo reproduce needs Snakemake: pip install 'ifo[reproduce]'")
    if execution.executor != "local" and find_spec(f"snakemake_executor_plugin_{execution.executor}") is None:
        raise PlatformError(
            f"--executor {execution.executor} needs Snakemake's plugin: "
            f"pip install snakemake-executor-plugin-{execution.executor}"
        )


@contextmanager
def _alone(folder: Path) -> Iterator[int]:
    """Make the folder and hold its lock. The last process that inherited the lock releases it.

    Snakemake's own lock would outlive a kill.
    """
    with ExitStack() as stack:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # Without O_NONBLOCK, opening a pipe would wait for its reader.
            descriptor = os.open(folder / LOCK, os.O_WRONLY | os.O_CREAT | os.O_NONBLOCK, 0o666)
            file = stack.enter_context(open(descriptor, "ab"))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(f"another `ifo reproduce` is running in {folder}: wait, or choose another --out") from None
        except OSError as error:
            raise PlatformError(f"{folder}: cannot be used ({error.strerror}): choose another --out") from error
        yield file.fileno()


def _run(folder: Path, execution: Execution, lock: int) -> None:
    """Run the jobs with Snakemake; its messages go to standard error."""
    here = execution.executor == "local"
    words = [sys.executable, "-P", "-c", ENGINE, "--snakefile", str(SNAKEFILE), "--config", f"jobs={JOBS}"]
    words += ["--executor", execution.executor, "--cores" if here else "--jobs", str(execution.cores)]
    # The Snakefile ignores dates; these options also ignore changes of code and machine. Stages write whole files or
    # none, so that no file is incomplete, even if Snakemake was killed before it recorded the end of a job.
    words += ["--rerun-triggers", "params", "--ignore-incomplete", "--nolock", "--keep-going"]
    words += ["--retries", str(RETRIES), "--quiet", "rules", "host", "reason"]
    if here:
        words += ["--resources", f"mem_mb={os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') // MEGABYTE}"]
    try:
        (folder / LOGS).mkdir(exist_ok=True)
    except OSError as error:
        raise PlatformError(f"{folder / LOGS}: cannot be created ({error.strerror}): remove it") from error
    # In its own process group, so that an interrupt reaches it and its jobs only once, from here.
    process = subprocess.Popen(
        words,
        cwd=folder,
        # Snakemake cannot start without a cache, and the home of a compute node may not be writable.
        env={**os.environ, "XDG_CACHE_HOME": str((folder / CACHE).absolute())},
        stdin=subprocess.DEVNULL,
        stdout=sys.stderr,
        pass_fds=[lock],
        process_group=0,
        preexec_fn=_interruptible,
    )
    with _killed_with_this_process(process.pid, lock):
        try:
            with killable():
                process.wait()
        except KeyboardInterrupt as error:
            os.killpg(process.pid, signal.SIGINT)
            process.wait()
            raise Interrupted(
                f"interrupted; finished files are in {folder}; continue with: {execution.command}"
            ) from error
    if process.returncode < 0:  # Snakemake itself was killed: its jobs are still running.
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def _interruptible() -> None:
    """Enable interrupts, which shells disable for `&`."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def _killed_with_this_process(group: int, lock: int) -> Iterator[None]:
    """Have a process group killed if this process is killed during the block; until then, the lock is held."""
    # A shell waits for the end of a pipe that only this process holds open.
    watcher = subprocess.Popen(
        ["sh", "-c", f"read _; kill -s KILL -- -{group}"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        pass_fds=[lock],
        start_new_session=True,
    )
    try:
        yield
    finally:
        watcher.kill()
        watcher.communicate()


def _failed(left: Sequence[Job], runs: Sequence[Job], folder: Path) -> str:
    """One line: the number of missing runs, and the last lines of the logs of the jobs that failed."""
    gone = {job.output for job in left}
    first = [job for job in left if not gone & set(job.inputs)]
    lost = sum(job.output in gone for job in runs)
    reasons = []
    for job in first[:3]:
        log = folder / LOGS / f"{job.name}.log"
        lines = log.read_text(errors="replace").strip().splitlines() if log.is_file() else []
        reasons.append(f"{log} ({lines[-1].removeprefix('ifo: ')})" if lines else f"{job.output} (no log)")
    more = f" and {len(first) - 3} more" if len(first) > 3 else ""
    return f"{lost} of {len(runs)} runs are missing; see {', '.join(reasons)}{more}; run the same command to retry"
