"""Commands that are killed or interrupted at any moment, and started again."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from artifacts import sha256_of
from tests.faults.case import TEMPORARY, Case, Verdict, kind
from tests.faults.originals import GRID, GRID_WORDS, STAGES, Stage, content_of
from tests.faults.server import Child, Outcome, command, complaint, start

CPU_SECONDS = 120
LIMIT = 600.0  # seconds of wall-clock time


def when(case: Case, child: Child, stage: Stage, took: float) -> str:
    """Wait for a random moment of a stage, and describe it."""
    moment = case.choose(("time", "writing", "checkpoint") if stage.checkpoints else ("time", "writing"))
    after = 1.2 * took * case.rng.random()
    count = int(case.rng.integers(1, 4))
    seen = 0
    last = None
    while child.running():
        if moment == "time" and time.monotonic() - child.started >= after:
            return f"after {after:.2f} s"
        if moment == "writing" and any(case.folder.glob(f".*{TEMPORARY}*")):
            seen += 1
            if seen == count:
                return f"while it writes, look {count}"
        if moment == "checkpoint":
            now = identity(case, stage)
            seen += now is not None and now != last
            last = now or last
            if seen == count:
                return f"after checkpoint {count}"
        time.sleep(0.001)
    return "never: it had ended"


def identity(case: Case, stage: Stage) -> tuple[int, int] | None:
    """Return what distinguishes a checkpoint from the next one."""
    try:
        found = (case.folder / stage.checkpoint).stat()
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_mtime_ns


def begin(case: Case, name: str, *more: object) -> Child:
    """Start a stage in the case's folder."""
    stage = STAGES[name]
    return start(case.folder, command(*stage.words, "--out", stage.out, *more), cpu_seconds=CPU_SECONDS)


def whole_or_none(case: Case, name: str, old: str) -> str:
    """Return what is wrong with the output of a stage that was stopped."""
    out = case.folder / STAGES[name].out
    if not out.exists():
        return "the old output is gone" if old else ""
    found = content_of(out)
    return "" if found in (old, case.originals.content[name]) else "the output is neither the old one nor the new one"


def again(case: Case, name: str) -> str:
    """Run a stage that was stopped again, to its end, and compare the result with that of an undisturbed run."""
    stage = STAGES[name]
    done = (case.folder / stage.out).exists()
    more = ("--resume",) if stage.checkpoints else ()
    resumes = (case.folder / stage.checkpoint).exists() and not done
    outcome = begin(case, name, *more).wait(LIMIT)
    if done and not stage.out.endswith(".h5"):  # An export refuses to replace what exists.
        return complaint(outcome, (0, 2)) or case.judge_output(name)
    problem = complaint(outcome, (0,))
    if problem:
        return f"started again: {problem}"
    if resumes and "resuming" not in outcome.stderr and "--quiet" not in stage.words:
        return "started again: ignores its checkpoint"
    if (case.folder / stage.checkpoint).exists():
        return "started again: leaves its checkpoint"
    return case.judge_output(name)


def old_output(case: Case, name: str) -> str:
    """Put another finished artifact in the output's place, in some cases; return its content digest."""
    stage = STAGES[name]
    if not stage.out.endswith(".h5") or case.rng.random() < 0.5:
        return ""
    other = case.choose(n for n in case.originals.files if n not in (*stage.inputs, stage.out))
    (case.folder / stage.out).write_bytes((case.originals.folder / other).read_bytes())
    return content_of(case.folder / stage.out)


def stopped(case: Case, number: signal.Signals) -> tuple[str, str, Outcome, str, str]:
    """Start a random stage and send it a signal; return stage, moment, outcome, and the old and the present problem."""
    name = case.choose(case.originals.outcomes)
    stage = STAGES[name]
    case.originals.copy(case.folder, tuple(n for n in stage.inputs))
    old = old_output(case, name)
    child = begin(case, name, *(("--overwrite",) if old else ()))
    moment = when(case, child, stage, case.originals.took[name])
    child.send(number)
    outcome = child.wait(LIMIT)
    what = f"{number.name} {moment}" + (", over an older output" if old else "")
    return name, what, outcome, old, whole_or_none(case, name, old)


@kind("killed, then started again", 14)
def killed(case: Case) -> Verdict:
    name, what, outcome, old, problem = stopped(case, signal.SIGKILL)
    if not problem and outcome.code not in (0, -signal.SIGKILL):
        problem = complaint(outcome, (0,))
    if not problem:
        remove_old(case, name, old)
        problem = again(case, name)
    return Verdict(name, what, problem)


@kind("interrupted, then started again", 10)
def interrupted(case: Case) -> Verdict:
    number = case.choose((signal.SIGINT, signal.SIGTERM))
    name, what, outcome, old, problem = stopped(case, number)
    if outcome.code != -number:  # Before and after a command handles signals, it ends as by SIGKILL.
        problem = problem or complaint(outcome, (0, 130)) or case.judge_leftovers()
    if not problem:
        remove_old(case, name, old)
        problem = again(case, name)
    return Verdict(name, what, problem)


def remove_old(case: Case, name: str, old: str) -> None:
    """Remove the older output, which would otherwise be refused, unless the new one has replaced it."""
    out = case.folder / STAGES[name].out
    if old and content_of(out) == old:
        out.unlink()


@kind("reproduce, stopped and started again", 0.5)
def stopped_reproduction(case: Case) -> Verdict:
    """Files that were finished before are untouched afterwards, byte for byte; all others have the same content."""
    number = case.choose((signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT))
    after = 1.1 * case.originals.took[GRID] * case.rng.random()
    folder = case.folder / GRID
    child = start(case.folder, command(*GRID_WORDS, "--out", GRID), cpu_seconds=CPU_SECONDS)
    while child.running() and time.monotonic() - child.started < after:
        time.sleep(0.01)
    child.send(number)
    outcome = child.wait(LIMIT)
    what = f"{number.name} after {after:.1f} s"
    # `wait` kills the group of the command, in which its jobs are not.
    jobs = outlived(folder)
    if jobs:
        return Verdict(GRID, what, f"its jobs outlive it: {jobs}")
    if outcome.code != -number and (problem := complaint(outcome, (0, 130))):
        return Verdict(GRID, what, problem)
    return Verdict(GRID, what, completed(case, folder))


def completed(case: Case, folder: Path) -> str:
    """Run a stopped reproduction to its end, and return what differs from an undisturbed one."""
    expected = contents(case.originals.folder / GRID)
    half = contents(folder)
    if wrong := [name for name, content in half.items() if content != expected.get(name)]:
        return f"{wrong[0]} differs from that of an undisturbed run, before it is started again"
    bytes_before = {name: sha256_of(folder / name) for name in half}
    outcome = start(case.folder, command(*GRID_WORDS, "--out", GRID), cpu_seconds=CPU_SECONDS).wait(LIMIT)
    if problem := complaint(outcome, (0,)):
        return f"started again: {problem}"
    if changed := [name for name, digest in bytes_before.items() if sha256_of(folder / name) != digest]:
        return f"{changed[0]} was made again although it was finished"
    found = contents(folder)
    if wrong := sorted({name for name in found | expected if found.get(name) != expected.get(name)}):
        return f"{wrong[0]} differs from that of an undisturbed run"
    return case.judge_leftovers()


def contents(folder: Path) -> dict[str, str]:
    """Return the content digest of each finished artifact in a folder."""
    return {path.name: content_of(path) for path in folder.glob("*.h5") if ".checkpoint." not in path.name}


def outlived(folder: Path, seconds: float = 10.0) -> list[str]:
    """Return the processes that still work in a folder after a time."""
    deadline = time.monotonic() + seconds
    while (left := working_in(folder)) and time.monotonic() < deadline:
        time.sleep(0.05)
    return left


def working_in(folder: Path) -> list[str]:
    """Return the numbers of the processes whose working folder is `folder`."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if os.readlink(process / "cwd") == str(folder):
                found.append(process.name)
        except OSError:  # It has ended.
            continue
    return found
