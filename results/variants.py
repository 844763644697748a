"""Makes results/variants.csv: what single options change, in the first five contexts of results/paper.py.

    python results/paper.py
    python results/variants.py

`jitter` and `jitter-dtw` learn from demonstrations whose tempo wanders by 40%, paired by equal time or by --align dtw;
`no-blur` leaves the blurred images out of R_img, as the paper does; `negatives` fine-tunes the features on what the
learner does; `plain` repeats the rows of paper.csv. Finished artifacts, in runs/variants, are not made again.
"""

from __future__ import annotations

import argparse
import csv
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from commands import ifo, runs_of
from plan import EXPERTS, RUNS

from stages.reporting.names import marked
from stages.reporting.rows import COLUMNS, csv_text, row
from stages.simulation.gl import choose_backend

HERE = Path(os.path.relpath(Path(__file__).parent))
VARIANTS = Path("runs/variants")
CONTEXTS = range(5)


@dataclass(frozen=True)
class Variant:
    """Options of three stages, and the tasks that they are tried on; no options of a stage: paper.py's file serves."""

    tasks: tuple[str, ...]
    collect: tuple[object, ...] = ()
    train: tuple[object, ...] = ()
    learn: tuple[object, ...] = ()


PLAN = {
    "jitter": Variant(("reach",), collect=("--jitter", 0.4)),
    "jitter-dtw": Variant(("reach",), collect=("--jitter", 0.4), train=("--align", "dtw")),
    "no-blur": Variant(("strike",), learn=("--blur", 0)),
    "negatives": Variant(("strike",), learn=("--negatives", 5)),
}
TASKS = ("reach", "strike")


def demonstrations(task: str, name: str) -> Path:
    """The variant's demonstrations; variants with the same options share them."""
    options = PLAN[name].collect
    if not options:
        return RUNS / f"{task}.demos.h5"
    words = ("collect-demos", task, "--expert", EXPERTS / f"{task}.expert.h5", *options)
    return ifo(*words, out=VARIANTS / f"{task}-{'-'.join(map(str, options)).strip('-')}.demos.h5")


def translator(task: str, name: str) -> Path:
    """The variant's translator."""
    variant = PLAN[name]
    if not variant.collect and not variant.train:
        return RUNS / f"{task}.translator.h5"
    words = ("train-translator", demonstrations(task, name), *variant.train, "--workers", 1, "--resume")
    return ifo(*words, out=VARIANTS / f"{task}-{name}.translator.h5")


def learn(task: str, name: str, seed: int) -> Path:
    """The variant's policy in one context."""
    variant = PLAN[name]
    trained = translator(task, name)
    folder, stem = (RUNS, task) if trained.parent == RUNS else (VARIANTS, f"{task}-{name}")
    words = ("translate", trained, "--context-seed", seed, "--workers", 1)
    translation = ifo(*words, out=folder / f"{stem}-c{seed}.translation.h5")
    words = ("learn-policy", translation, *variant.learn, "--workers", 1, "--resume")
    return ifo(*words, out=VARIANTS / f"{task}-{name}-c{seed}.policy.h5")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parallel", type=int, default=2, help="runs side by side")
    parser.add_argument("--only", nargs="*", default=list(PLAN), choices=list(PLAN), help="variants to run")
    arguments = parser.parse_args()
    choose_backend()
    VARIANTS.mkdir(parents=True, exist_ok=True)
    cells = [(task, name) for name in arguments.only for task in PLAN[name].tasks]
    for task, name in cells:  # One after the other: variants that share demonstrations must not both collect them.
        demonstrations(task, name)
    with ThreadPoolExecutor(arguments.parallel) as pool:
        list(pool.map(lambda cell: translator(*cell), cells))
        jobs = [(task, name, seed) for task, name in cells for seed in CONTEXTS]
        list(pool.map(lambda job: learn(*job), jobs))
    with (HERE / "paper.csv").open(newline="") as file:
        table: list[dict[str, object]] = [
            {**row, "method": "plain"}
            for row in csv.DictReader(file)
            if row["task"] in TASKS and row["method"] == "translation" and int(row["context_seed"]) in CONTEXTS
        ]
    for task, name in ((task, name) for task in TASKS for name in PLAN):
        policies = [VARIANTS / f"{task}-{name}-c{seed}.policy.h5" for seed in CONTEXTS]
        if not all(policy.exists() for policy in policies):
            continue
        evaluation = VARIANTS / f"{task}-{name}.evaluation.h5"
        evaluation.unlink(missing_ok=True)
        ifo("evaluate", *policies, out=evaluation)
        for run in runs_of(evaluation, PLAN[name].learn):
            # What `ifo translate` said of the reward, it said of the one without these options.
            kept = {key: value for key, value in row(run).items() if not (PLAN[name].learn and key.startswith("tau_"))}
            table.append({**kept, "method": marked(name, run.recorded)})
    table.sort(key=lambda row: TASKS.index(str(row["task"])))
    (HERE / "variants.csv").write_text(csv_text(COLUMNS, table), encoding="utf-8", newline="")


if __name__ == "__main__":
    main()
