"""Standard streams that are closed, full, abandoned or not UTF-8, and hostile text on standard input."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from tests.faults.case import Case, Verdict, kind
from tests.faults.injections.forged import DEEP, TEXTS
from tests.faults.originals import STAGES
from tests.faults.server import Outcome, command, complaint, run

QUICK = (
    ("--version",), ("--help",), ("doctor",), ("verify", "x.expert.h5"), ("inspect", "x.policy.h5"),
    ("report", "x.evaluation.h5", "--out", "r.html"), ("verify", "nothing.h5"), ("nonsense",),
    ("collect-demos", "reach", "--show-config"), ("export-demos", "x.demos.h5", "--format", "lerobot", "--out", "l"),
    ("import-demos", "videos", "--frames", 5, "--size", "32x24", "--out", "i.demos.h5"),
)  # fmt: skip
READING = [name for name, stage in STAGES.items() if stage.inputs and stage.inputs[0] == stage.words[1]]
READ = ("x.expert.h5", "x.policy.h5", "x.translation.h5", "x.translator.h5", "x.demos.h5", "x.evaluation.h5", "videos")


def with_streams(task, stdout: str, stderr: str, encoding: str):
    """Return a task that runs with its streams closed, full, abandoned or in another encoding."""

    def descriptor(how: str, number: int) -> None:
        if how == "closed":
            os.close(number)
        elif how == "full":
            os.dup2(os.open("/dev/full", os.O_WRONLY), number)
        elif how == "abandoned":
            reading, writing = os.pipe()
            os.close(reading)
            os.dup2(writing, number)

    def opened(how: str, number: int):
        if how == "closed":
            return None
        errors = "backslashreplace" if number == 2 else "strict"
        return open(number, "w", encoding=encoding, errors=errors, closefd=False)

    def run_it() -> int:
        for how, number in sorted(((stdout, 1), (stderr, 2)), key=lambda pair: pair[0] == "closed"):
            descriptor(how, number)  # Those to close come last, or what is opened next would take their numbers.
        sys.stdout, sys.stderr = opened(stdout, 1), opened(stderr, 2)
        sys.__stdout__, sys.__stderr__ = sys.stdout, sys.stderr
        code = task()
        for stream in (sys.stdout, sys.stderr):
            try:
                if stream is not None:
                    stream.flush()
            except OSError:
                code = code or 120
        sys.stdout = sys.stderr = None  # type: ignore[assignment]
        return code

    return run_it


@kind("standard streams", 40)
def standard_streams(case: Case) -> Verdict:
    there = tuple(name for name in READ if (case.originals.folder / name).exists())
    case.originals.copy(case.folder, there)
    words = case.choose(words for words in QUICK if not (set(READ) - set(there)) & set(words))
    stdout, stderr = (case.choose(("open", "open", "closed", "full", "abandoned")) for _ in range(2))
    encoding = case.choose(("utf-8", "ascii", "latin-1", "utf-16"))
    outcome = run(case.folder, with_streams(command(*words), stdout, stderr, encoding))
    what = f"{' '.join(map(str, words))}: standard output {stdout}, standard error {stderr}, {encoding}"
    failing = words in (("verify", "nothing.h5"), ("nonsense",))
    codes = (2, 3) if failing else (4,) if stdout == "full" else (0,)
    if encoding == "utf-16":  # Its error lines cannot be read as text here.
        outcome = Outcome(**{**vars(outcome), "stderr": "", "stdout": ""})
        problem = "" if outcome.code in codes and not outcome.hung else complaint(outcome, codes) or "wrong exit code"
        return Verdict(str(words[0]), what, problem)
    problem = complaint(outcome, codes) if stderr == "open" else silent_complaint(outcome, codes)
    return Verdict(str(words[0]), what, problem)


def silent_complaint(outcome: Outcome, codes: tuple[int, ...]) -> str:
    """As `complaint`, for a command whose standard error goes nowhere."""
    if outcome.hung or outcome.code < 0:
        return complaint(outcome, codes)
    return "" if outcome.code in codes else f"exit code {outcome.code}, expected {codes}"


@kind("standard input", 40)
def standard_input(case: Case) -> Verdict:
    """Bytes that are no path, where a command reads the path of its input."""
    name = case.choose(READING)
    stage = STAGES[name]
    words = [word for word in stage.words if word != stage.inputs[0]]
    pick = case.choose(("text", "bytes", "deep", "lines", "long", "endless", "json", "closed"))
    data: bytes | int = b""
    if pick == "text":
        data = str(case.choose(TEXTS)).encode("utf-8", "surrogatepass")
    elif pick == "bytes":
        data = case.rng.bytes(int(case.rng.integers(1, 5_000)))
    elif pick == "deep":
        data = DEEP.encode() if case.rng.random() < 0.5 else b'{"path": ' * 20_000
    elif pick == "lines":
        data = b"\n".join([b"a.h5"] * int(case.rng.integers(2, 1_000)))
    elif pick == "long":
        data = b"x" * int(case.rng.integers(10**5, 10**7))
    elif pick == "json":
        data = case.choose((b'{"path": 5}', b'{"path": null}', b"{}", b"[1]", b'{"path": "' + b"a" * 5_000 + b'"}'))
    elif pick == "endless":
        data = os.open("/dev/zero", os.O_RDONLY)
    task = command(*words, "--out", stage.out)
    outcome = run(case.folder, closed_stdin(task) if pick == "closed" else task, stdin=data)
    if isinstance(data, int):
        os.close(data)
    return Verdict(name, f"standard input: {pick}", complaint(outcome, (2, 3), 400 << 20))


def closed_stdin(task):
    def run_it() -> int:
        os.close(0)
        sys.stdin = None  # type: ignore[assignment]
        return task()

    return run_it


@kind("odd output", 25)
def odd_output(case: Case) -> Verdict:
    """Names that no file can have, folders, pipes, devices and missing or closed folders as --out."""
    name = case.choose(n for n in STAGES if n in case.originals.outcomes)
    stage = STAGES[name]
    case.originals.copy(case.folder, stage.inputs)
    way = case.choose(("long", "nul", "folder", "fifo", "device", "circle", "under a file", "suffix", "text", "gone"))
    suffix = Path(stage.out).suffix
    out: object = f"o{suffix}"
    target = case.folder / str(out)
    if way == "long":
        out = "x" * int(case.rng.integers(250, 5_000)) + suffix
    elif way == "nul":
        out = f"a\0b{suffix}"
    elif way == "folder":
        target.mkdir()
    elif way == "fifo":
        os.mkfifo(target)
    elif way == "device":
        target.symlink_to("/dev/null")
    elif way == "circle":
        target.symlink_to(target.name)
    elif way == "under a file":
        (case.folder / "file").write_text("kept")
        out = f"file/x{suffix}"
    elif way == "suffix":
        out = case.choose(("x.txt", "x", "", ".", "..", "/", "x.checkpoint.h5"))
    elif way == "text":
        out = case.choose([text for text in TEXTS if "\ud800" not in text]) + suffix
    task = command(*stage.words, "--out", out)
    outcome = run(case.folder, deleted_folder(task) if way == "gone" else task, cpu_seconds=90)
    # A stage may accept a name that is merely unusual.
    codes = (0, 2, 3, 4) if way in ("text", "suffix", "gone", "long", "folder") else (2, 3, 4)
    return Verdict(name, f"--out: {way} {str(out)[:40]!r}", complaint(outcome, codes) or case.judge_leftovers())


def deleted_folder(task):
    def run_it() -> int:
        os.mkdir("gone")
        os.chdir("gone")
        os.rmdir("../gone")
        return task()

    return run_it
