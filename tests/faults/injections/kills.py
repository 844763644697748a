"""Commands that are killed or interrupted at any moment, and started again."""

from __future__ import annotations

import signal
import time

from tests.faults.case import TEMPORARY, Case, Verdict, kind
from tests.faults.originals import STAGES, Stage, content_of
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
