"""Coverage-guided fuzzing of the targets in tests/fuzzing/, with atheris.

    make fuzz MINUTES=5        or        python -m tests.fuzzing --minutes 5 --only "crop files"

Each target runs in a process of its own, for as many minutes of CPU time. Its corpus, the inputs that reached new
lines, stays in runs/fuzz/ for the next run. An input that is not handled is kept there, too: `--only NAME --input FILE`
repeats it. The table goes to results/faults.md.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from tests.fuzzing.memory import GIVEN, IN_MEMORY, PREFIX

MODULES = ("test_artifacts", "test_inputs", "test_datasets")
MOST_SECONDS = 10  # of one input
MOST_MEMORY = 3072  # MiB of a target's process
LONGEST_INPUT = 1024  # bytes from which the strategies draw
BEHIND = Path("runs/fuzz")


@dataclass(frozen=True)
class Found:
    """What fuzzing a target gave.

    Attributes:
        target: Its name.
        minutes: CPU time.
        inputs: How many inputs were tried.
        corpus: How many of them reached something new.
        problem: The last lines of the first failure; empty: none.
    """

    target: str
    minutes: float
    inputs: int
    corpus: int
    problem: str


def fuzz(name: str, folder: Path, seconds: float) -> None:
    """Fuzz a target in this process, which ends with it."""
    import atheris

    os.environ |= {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"}
    with atheris.instrument_imports(include=["artifacts", "stages", "ifo_cli"]):
        targets = load()
    one_input = targets[name].hypothesis.fuzz_one_input  # type: ignore[attr-defined]
    limit = time.process_time() + seconds

    def test(data: bytes) -> None:
        one_input(data)
        if time.process_time() > limit:  # libFuzzer itself measures wall-clock time.
            print(f"Done {name}", file=sys.stderr, flush=True)
            os._exit(0)

    (folder / "corpus").mkdir(parents=True, exist_ok=True)
    words = [sys.argv[0], str(folder / "corpus"), f"-artifact_prefix={folder}/", f"-timeout={MOST_SECONDS}"]
    words += [f"-rss_limit_mb={MOST_MEMORY}", f"-max_len={LONGEST_INPUT}", "-len_control=0"]
    atheris.Setup(words, test)
    atheris.Fuzz()


def load() -> dict[str, object]:
    """Import the modules that register the targets, and return these by name."""
    for module in MODULES:
        import_module(f"tests.fuzzing.{module}")
    from tests.fuzzing.targets import TARGETS

    return dict(TARGETS)


def folder_of(name: str) -> Path:
    return BEHIND / re.sub(r"\W+", "-", name).strip("-")


def in_process(name: str, minutes: float) -> Found:
    """Fuzz a target in a process of its own, and report what came of it."""
    folder = folder_of(name)
    folder.mkdir(parents=True, exist_ok=True)
    words = [sys.executable, "-m", "tests.fuzzing", "--only", name, "--minutes", str(minutes), "--here"]
    # The process ends without its clean-up, or is ended by libFuzzer.
    with open(folder / "log", "wb") as log, tempfile.TemporaryDirectory(prefix=PREFIX, dir=IN_MEMORY) as place:
        environment = {**os.environ, GIVEN: place}
        child = subprocess.Popen(words, stdout=log, stderr=log, stdin=subprocess.DEVNULL, env=environment)
        _, status, usage = os.wait4(child.pid, 0)
    code = os.waitstatus_to_exitcode(status)
    said = (folder / "log").read_text(errors="replace")
    tried = [int(number) for number in re.findall(r"^#(\d+)\t", said, re.M)]
    problem = "" if code == 0 else " | ".join(line for line in said.splitlines()[-40:] if line.strip())[-1500:]
    used = (usage.ru_utime + usage.ru_stime) / 60
    return Found(name, used, max(tried, default=0), len(list((folder / "corpus").iterdir())), problem)


def section(found: list[Found], minutes: float) -> str:
    """The section on fuzzing of results/faults.md."""
    failed = [one for one in found if one.problem]
    hours = sum(one.minutes for one in found) / 60
    text = [
        f"{sum(one.inputs for one in found)} inputs in {hours:.1f} hours of CPU time, {len(failed)} targets failed.",
        "",
        f"Made by `make fuzz MINUTES={minutes:g}`. Every input must be refused in one line or give a valid result,",
        f"within {MOST_SECONDS} seconds and {MOST_MEMORY >> 10} GiB.",
        "",
        "| Target | CPU minutes | Inputs | Corpus | Failed |",
        "|---|---:|---:|---:|---:|",
        *(
            f"| {one.target} | {one.minutes:.1f} | {one.inputs} | {one.corpus} | {int(bool(one.problem))} |"
            for one in found
        ),
    ]
    return "\n".join(text)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzzing", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=1.0, help="CPU time of each target")
    parser.add_argument("--only", action="append", help="only this target")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="targets at a time")
    parser.add_argument("--input", type=Path, help="run the target on this file only")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, help="the page to write the table to (default: standard output)")
    options = parser.parse_args()
    if options.here:
        fuzz(options.only[0], folder_of(options.only[0]), 60 * options.minutes)
    targets = load()
    if unknown := [name for name in options.only or () if name not in targets]:
        parser.error(f"{unknown[0]!r} is no target: expected one of {', '.join(targets)}")
    if options.input:
        targets[options.only[0]].hypothesis.fuzz_one_input(options.input.read_bytes())  # type: ignore[attr-defined]
        return 0
    with ThreadPoolExecutor(options.jobs) as pool:
        found = list(pool.map(lambda name: in_process(name, options.minutes), options.only or list(targets)))
    for one in found:
        if one.problem:
            print(f"{one.target}: {one.problem}\n  see {folder_of(one.target)}", file=sys.stderr)
    text = section(found, options.minutes)
    if options.out:
        from tests.faults.table import write_section

        write_section(options.out, "Fuzzing", text)
    else:
        print(text)
    return 1 if any(one.problem for one in found) else 0


if __name__ == "__main__":
    sys.exit(main())
