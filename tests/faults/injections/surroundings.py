"""Disks that fill up, permissions and inputs that go away while a command runs, and two writers of one file."""

from __future__ import annotations

import ctypes
import os
import resource
import shutil
import signal
import sys
import time
from pathlib import Path

from artifacts import read_artifact
from tests.faults.case import Case, Verdict, kind
from tests.faults.originals import STAGES, content_of
from tests.faults.server import command, complaint, mount_tmpfs, start, unmount

CLONE_NEWPID = 0x20000000
LIMIT = 600.0


def inputs_elsewhere(case: Case, name: str) -> tuple[object, ...]:
    """Copy a stage's inputs to a folder `in`, and return its words with their new names."""
    stage = STAGES[name]
    case.originals.copy(case.folder / "in", stage.inputs)
    named = {*stage.inputs, "."}
    return tuple(f"in/{word}".rstrip("./") if word in named else word for word in stage.words)


@kind("disk full", 10)
def disk_full(case: Case) -> Verdict:
    """The output's file system has room for a random part of what the stage writes."""
    name = case.choose(case.originals.outcomes)
    stage = STAGES[name]
    words = inputs_elsewhere(case, name)
    target = case.folder / "out"
    target.mkdir()
    original = case.originals.folder / stage.out
    size = sum(f.stat().st_size for f in original.rglob("*")) if original.is_dir() else original.stat().st_size
    room = int(1.5 * size * case.rng.random())
    real = os.geteuid() == 0 and mount_tmpfs(target, max(4096, room))
    try:
        problem = judge_full(case, name, words, 0 if real else room)
        return Verdict(name, f"{room} bytes of room" + ("" if real else " per file"), problem)
    finally:
        if real:
            unmount(target)


def judge_full(case: Case, name: str, words: tuple[object, ...], largest: int) -> str:
    """Run a stage whose output does not fit, and return what is wrong; `largest`: bytes a file may have, 0: any."""
    out = f"out/{STAGES[name].out}"

    def task() -> int:
        if largest:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
        return command(*words, "--out", out)()

    outcome = start(case.folder, task, cpu_seconds=120).wait(LIMIT)
    problem = complaint(outcome, (0, 4))
    if problem:
        return problem
    written = case.folder / out
    if outcome.code == 0 and (not written.exists() or content_of(written) != case.originals.content[name]):
        return "silent: the output is missing or differs"
    if outcome.code and written.exists():
        return f"leaves {out} although it failed"
    return case.judge_leftovers()


@kind("input changed while it is read", 10)
def input_changed(case: Case) -> Verdict:
    """An input is removed, truncated, or replaced by another file of its kind, at a random moment."""
    name = case.choose(n for n in case.originals.outcomes if STAGES[n].inputs)
    stage = STAGES[name]
    case.originals.copy(case.folder, stage.inputs)
    # translate needs the expert only to rate the reward, and evaluate the ancestors only to name the method.
    optional = {"translate": ("x.expert.h5",), "evaluate": stage.inputs[1:]}.get(stage.command, ())
    needed = [given for given in stage.inputs if given not in optional]
    victim = case.folder / case.choose(needed)
    if victim.is_dir():
        victim = case.choose(sorted(victim.iterdir()))
    change = case.choose(("removed", "truncated", "replaced", "unreadable"))
    after = case.rng.random() * case.originals.took[name]
    child = start(case.folder, command(*stage.words, "--out", stage.out), cpu_seconds=120, restricted=True)
    while child.running() and time.monotonic() - child.started < after:
        time.sleep(0.001)
    if change == "removed":
        victim.unlink()
    elif change == "truncated":
        os.truncate(victim, int(case.rng.random() * victim.stat().st_size))
    elif change == "replaced":
        other = case.folder / "other"
        other.write_bytes((case.originals.folder / case.choose(case.originals.files)).read_bytes())
        os.replace(other, victim)
    else:
        victim.chmod(0)
    outcome = child.wait(LIMIT)
    problem = complaint(outcome, (0, 2, 3) if change == "unreadable" else (0, 3))
    if not problem and outcome.code == 0 and not stage.out.endswith("html"):
        problem = unchanged_or_told(case, name, outcome.stderr)
    return Verdict(name, f"{victim.name} {change} after {after:.2f} s", problem)


def unchanged_or_told(case: Case, name: str, said: str) -> str:
    """Return whether a stage used a changed input without a word. A video that is skipped is a warning."""
    out = case.folder / STAGES[name].out
    if not out.exists():
        return "exit code 0, but there is no output"
    if content_of(out) == case.originals.content[name] or "skipped" in said:
        return ""
    return "silent: the output differs from that of an undisturbed run"


@kind("permission taken away", 8)
def permission_taken(case: Case) -> Verdict:
    """The folder of the output loses its permissions at a random moment; the command runs as an ordinary user."""
    name = case.choose(case.originals.outcomes)
    stage = STAGES[name]
    words = inputs_elsewhere(case, name)
    target = case.folder / "out"
    target.mkdir()
    out = f"out/{stage.out}"
    after = 1.1 * case.rng.random() * case.originals.took[name]
    child = start(case.folder, command(*words, "--out", out), cpu_seconds=120, restricted=True)
    while child.running() and time.monotonic() - child.started < after:
        time.sleep(0.001)
    target.chmod(0o555)
    outcome = child.wait(LIMIT)
    target.chmod(0o755)
    problem = complaint(outcome, (0, 4))
    if not problem and outcome.code == 0 and not same(case.folder / out, case.originals.folder / stage.out):
        problem = "silent: the output differs"
    return Verdict(name, f"permission to write taken away after {after:.2f} s", problem)


def same(written: Path, original: Path) -> bool:
    """Return whether two outputs hold the same data, whatever the names of the inputs."""
    if written.name.startswith("i.demos"):  # import-demos records the names of videos.
        return read_artifact(written).manifest.datasets == read_artifact(original).manifest.datasets
    return content_of(written) == content_of(original)


@kind("two writers of one output", 8)
def two_writers(case: Case) -> Verdict:
    """Two runs of one command write one file, in some cases in two PID namespaces."""
    name = case.choose(n for n in case.originals.outcomes if STAGES[n].out.endswith(".h5"))
    stage = STAGES[name]
    case.originals.copy(case.folder, stage.inputs)
    namespaces = os.geteuid() == 0 and case.rng.random() < 0.5
    children = []
    for number in (0, 1):
        folder = case.folder.parent / f"{case.folder.name}-{number}"
        folder.mkdir()
        task = command(*stage.words, "--out", stage.out)
        children.append(start(folder, inside(case.folder, in_namespace(task) if namespaces else task), cpu_seconds=120))
        time.sleep(case.rng.random() * 0.3)
    outcomes = [child.wait(LIMIT) for child in children]
    for number in (0, 1):
        for path in (f"{case.folder.name}-{number}", f"{case.folder.name}-{number}.output"):
            shutil.rmtree(case.folder.parent / path, ignore_errors=True)
    # The second one to finish must not replace what the first one has just written.
    problems = [complaint(outcome, (0, 2)) for outcome in outcomes]
    problem = next(filter(None, problems), "") or case.judge_output(name)
    if all(outcome.code for outcome in outcomes):
        problem = problem or "both writers fail"
    return Verdict(name, "two writers" + (" in two PID namespaces" if namespaces else ""), problem)


def inside(folder: Path, task):
    """Return a task that runs in a folder."""

    def run() -> int:
        os.chdir(folder)
        return task()

    return run


def in_namespace(task):
    """Return a task that runs as process 1 of a PID namespace, as in a container."""

    def run() -> int:
        if ctypes.CDLL(None).unshare(CLONE_NEWPID):
            print("no PID namespace can be made here", file=sys.stderr)
            return 1
        pid = os.fork()
        if pid:
            return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        code = 1
        try:
            code = task()
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)

    return run
