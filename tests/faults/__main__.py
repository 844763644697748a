"""Fault injection: thousands of damaged files, kills, full disks and hostile inputs, drawn with a seed.

    make faults N=1000 SEED=1        or        python -m tests.faults --n 1000 --seed 1 --only "flipped bits"

Each injection is a case of its own: `--case 417` repeats one. The table goes to results/faults.md.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from contextlib import suppress
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from tests.faults.case import KINDS, Case, Verdict
from tests.faults.originals import GRID, STAGES, Originals
from tests.faults.server import prepare
from tests.faults.table import write_section

MODULES = ("damage", "forged", "odd_hdf5", "inputs", "kills", "streams", "surroundings")


def schedule(kinds: list[str], count: int, seed: int) -> list[str]:
    """Return the kind of each injection: each gets its share, in a random order."""
    shares = np.array([KINDS[name][1] for name in kinds])
    counts = np.maximum(1, np.floor(count * shares / shares.sum())).astype(int)
    while counts.sum() > count and counts.max() > 1:
        counts[counts.argmax()] -= 1
    names = [name for name, n in zip(kinds, counts, strict=True) for _ in range(n)][:count]
    names += [kinds[int(shares.argmax())]] * (count - len(names))
    return [names[i] for i in np.random.default_rng(seed).permutation(count)]


def inject(number: int, name: str, seed: int, originals: Originals, work: Path) -> Verdict:
    """Make one injection in a folder of its own, and remove the folder."""
    folder = work / f"case-{number}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    case = Case(originals, folder, np.random.default_rng(np.random.SeedSequence([seed, number])))
    try:
        return KINDS[name][0](case)
    except Exception:  # A fault of the injection itself must not end the run, and must not pass for a success.
        return Verdict("harness", name, "the injection itself failed: " + traceback.format_exc())
    finally:
        for path in (folder, work / f"case-{number}.output"):
            shutil.rmtree(path, ignore_errors=True)


def work_through(
    part: int, kinds: list[str], options: argparse.Namespace, work: Path, log: Path, before: set[int]
) -> None:
    """Make every `options.jobs`-th injection that was not made before, and append one JSON line to `log` for each."""
    originals = Originals.found(work / "originals")
    started = time.monotonic()
    done = before | {line["case"] for line in lines_of(log)}
    with log.open("a") as file:
        for number, name in enumerate(kinds):
            if number % options.jobs != part or (options.case is not None and number != options.case):
                continue
            if number in done:
                continue
            if options.minutes and time.monotonic() - started > 60 * options.minutes:
                break
            begun = time.monotonic()
            verdict = inject(number, name, options.seed, originals, work)
            line = {"case": number, "kind": name, **asdict(verdict), "seconds": round(time.monotonic() - begun, 2)}
            print(json.dumps(line), file=file, flush=True)
            if verdict.problem or options.case is not None:
                problem = verdict.problem or "handled"
                print(f"case {number}, {name}, {verdict.stage}: {verdict.what}: {problem}", file=sys.stderr, flush=True)


def start_part(
    part: int, kinds: list[str], options: argparse.Namespace, work: Path, log: Path, before: set[int]
) -> int:
    """Fork a process that runs `work_through`, and return its number."""
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        work_through(part, kinds, options, work, log, before)
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def blame(part: int, kinds: list[str], jobs: int, log: Path, before: set[int], problem: str) -> None:
    """Record as failed the first injection of a part that was not made before and that its log lacks."""
    done = before | {line["case"] for line in lines_of(log)}
    case = next(number for number in range(part, len(kinds), jobs) if number not in done)
    print(f"case {case}, {kinds[case]}: {problem}", file=sys.stderr, flush=True)
    line = {"case": case, "kind": kinds[case], "stage": "harness", "what": "", "problem": problem, "seconds": 0.0}
    with log.open("a") as file:
        print(json.dumps(line), file=file)


def lines_of(log: Path) -> list[dict[str, Any]]:
    """Return the injections in a log, and remove a last line that was cut off."""
    if not log.exists():
        return []
    text = log.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        log.write_text(whole)
    return [json.loads(line) for line in whole.splitlines()]


def section(lines: list[dict[str, Any]], count: int, seed: int, seconds: float) -> str:
    """The section on injections of results/faults.md.

    Args:
        lines: The injections that were made.
        count, seed: What they were drawn with.
        seconds: Sum over the injections.
    """
    failed = [line for line in lines if line["problem"]]
    stages = Counter(str(line["stage"]) for line in lines)
    text = [
        f"{len(lines)} injections, {len(failed)} failed.",
        "",
        f"Made by `make faults N={count} SEED={seed}` in {seconds / 3600:.1f} hours, summed over parallel jobs.",
        "A damaged file is refused in one line, or read as it was written. A command that is killed, or whose disk,",
        "permissions, inputs or streams fail, leaves the old output, the whole new one, or none; started again, it",
        "ends as if undisturbed.",
        "",
        "| Kind | Injections | Commands | Failed |",
        "|---|---:|---:|---:|",
    ]
    for name in KINDS:
        mine = [line for line in lines if line["kind"] == name]
        if mine:
            bad = sum(bool(line["problem"]) for line in mine)
            text.append(f"| {name} | {len(mine)} | {len({line['stage'] for line in mine})} | {bad} |")
    text += ["", "| Command | Injections | Failed |", "|---|---:|---:|"]
    for stage, of_stage in sorted(stages.items()):
        bad = sum(bool(line["problem"]) for line in lines if line["stage"] == stage)
        text.append(f"| {stage} | {of_stage} | {bad} |")
    if failed:
        text += ["", "Failed:", ""]
        text += [f"- case {line['case']}, {line['kind']}, {line['stage']}: {line['problem']}" for line in failed]
    return "\n".join(text) + "\n"


def load_kinds() -> None:
    """Import the modules that register the kinds."""
    for module in MODULES:
        import_module(f"tests.faults.injections.{module}")


def main() -> int:
    load_kinds()
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--n", type=int, default=1000, help="number of injections")
    parser.add_argument("--seed", type=int, default=1, help="seed of the injections")
    parser.add_argument("--only", action="append", choices=list(KINDS), help="only this kind")
    parser.add_argument("--stages", help="commands to prepare, separated by commas (default: all)")
    parser.add_argument("--case", type=int, help="make only this injection")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="injections at a time")
    parser.add_argument("--minutes", type=float, default=0, help="stop after this time (0: no limit)")
    parser.add_argument("--keep", type=Path, help="keep the undamaged files in this folder, and use them again")
    parser.add_argument("--log", type=Path, help="continue from the injections in this folder; removed at the end")
    parser.add_argument("--out", type=Path, help="the page to write the table to (default: standard output)")
    options = parser.parse_args()
    kinds = schedule(options.only or list(KINDS), options.n, options.seed)
    prepare()
    with tempfile.TemporaryDirectory(prefix="faults-") as temporary:
        work = Path(temporary)
        folder = options.log or work / "log"
        folder.mkdir(parents=True, exist_ok=True)
        chosen = tuple(options.stages.split(",")) if options.stages else (*STAGES, GRID)
        Originals.made(work / "originals", chosen, options.keep or (options.log and folder / "originals"))
        logs = [folder / f"log-{part}" for part in range(options.jobs)]
        # Of an earlier run, which may have had another number of jobs.
        before = {line["case"] for log in folder.glob("log-*") for line in lines_of(log)}
        parts = {start_part(part, kinds, options, work, log, before): part for part, log in enumerate(logs)}
        while parts:
            pid, status = os.wait()
            part = parts.pop(pid, None)
            if part is not None and status:
                # The injection that was under way has ended the harness itself: it counts as failed, the others go on.
                ended = os.waitstatus_to_exitcode(status)
                problem = f"the injection itself ended the harness ({ended})"
                blame(part, kinds, options.jobs, logs[part], before, problem)
                parts[start_part(part, kinds, options, work, logs[part], before)] = part
        lines = sorted((line for log in folder.glob("log-*") for line in lines_of(log)), key=lambda line: line["case"])
        text = section(lines, options.n, options.seed, sum(line["seconds"] for line in lines))
        if options.out:
            write_section(options.out, "Injections", text)
        else:
            print(text)
        if options.log and len(lines) == len(kinds):
            for log in folder.glob("log-*"):
                log.unlink()
            shutil.rmtree(folder / "originals", ignore_errors=True)
            with suppress(OSError):  # Something else is in it.
                folder.rmdir()
    return 1 if any(line["problem"] for line in lines) else 0


if __name__ == "__main__":
    sys.exit(main())
