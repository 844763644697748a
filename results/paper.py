"""Makes results/paper.csv and paper.md: the paper's experiment on a CPU, run with the commands of the CLI.

    python results/tasks.py     # experts, and the oracle's runs
    python results/paper.py

Demonstrations in the paper's contexts, one compact translator per task, and in each unseen context a policy that
learns only from the translation reward. Finished artifacts in runs/paper are not made again. --only selects tasks; the
tables keep their rows of tasks whose artifacts are missing.
"""

from __future__ import annotations

import argparse
import csv
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from commands import ifo, runs_of
from plan import EXPERTS, HERE, PLANS, RUNS, TRANSLATOR_COLUMNS
from report import grid, minutes, plot, report

from artifacts import Artifact, read_artifact
from stages.reporting.rows import COLUMNS, csv_text, row
from stages.simulation.gl import choose_backend


def train(task: str) -> Path:
    """Demonstrations and translator of a task."""
    words = ("collect-demos", task, "--expert", EXPERTS / f"{task}.expert.h5", "--workers", 1)
    demos = ifo(*words, out=RUNS / f"{task}.demos.h5")
    if PLANS[task].random:
        ifo("train-translator", demos, "--steps", 0, "--workers", 1, out=RUNS / f"{task}-random.translator.h5")
    return ifo("train-translator", demos, "--workers", 1, "--resume", out=RUNS / f"{task}.translator.h5")


def stem(task: str, method: str) -> str:
    """Start of a run's file names."""
    return task if method == "translation" else f"{task}-{method}"


def seeds(task: str, method: str) -> range:
    """Seeds of the contexts that a method runs in."""
    return range(PLANS[task].random if method == "random" else PLANS[task].contexts)


def learn(task: str, method: str, seed: int) -> Path:
    """Translate into one context and learn there."""
    name = RUNS / f"{stem(task, method)}-c{seed}"
    words = ("translate", RUNS / f"{stem(task, method)}.translator.h5", "--context-seed", seed, "--workers", 1)
    translation = ifo(*words, out=Path(f"{name}.translation.h5"))
    return ifo("learn-policy", translation, "--workers", 1, "--resume", out=Path(f"{name}.policy.h5"))


def evaluate(task: str, method: str) -> Path | None:
    """The evaluation of a task's runs; the oracle's are those of tasks.py. None where they are not all there."""
    if method == "oracle":
        return HERE / f"oracle-{task}.evaluation.h5"
    policies = [RUNS / f"{stem(task, method)}-c{seed}.policy.h5" for seed in seeds(task, method)]
    if not policies or not all(policy.exists() for policy in policies):
        return None
    out = HERE / f"paper-{stem(task, method)}.evaluation.h5"
    out.unlink(missing_ok=True)
    return ifo("evaluate", *policies, out=out)


def rows(task: str, evaluation: Path) -> list[dict[str, object]]:
    """One row per run in a context of the plan, as `ifo report` writes them."""
    return [row(run) for run in runs_of(evaluation) if run.recorded["context_seed"] < PLANS[task].contexts]


def translator_row(task: str, translator: Artifact) -> dict[str, object]:
    """A row of translators.csv: cost and held-out figures."""
    measured = {name: round(float(value), 3) for name, value in translator.group("metrics").items()}
    config = {name: translator.config[name] for name in ("demonstrations", "steps")}
    known = {"task": task, **config, "minutes": round(minutes(translator), 1), **measured}
    return {name: known[name] for name in TRANSLATOR_COLUMNS}


def kept(path: Path, tasks: list[str]) -> list[dict[str, object]]:
    """Rows of an earlier table, of tasks that are not among `tasks`."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return [dict(row) for row in csv.DictReader(file) if row["task"] not in tasks]


def write(path: Path, columns: tuple[str, ...], table: list[dict[str, object]]) -> list[dict[str, object]]:
    """Write a table, its tasks in the order of PLANS; returns it so ordered."""
    table = sorted(table, key=lambda row: list(PLANS).index(str(row["task"])))
    path.write_text(csv_text(columns, table), encoding="utf-8", newline="")
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parallel", type=int, default=2, help="runs side by side")
    parser.add_argument("--only", nargs="*", default=list(PLANS), choices=list(PLANS), help="tasks to run")
    parser.add_argument("--report", action="store_true", help="write the tables from what is there")
    arguments = parser.parse_args()
    choose_backend()
    RUNS.mkdir(parents=True, exist_ok=True)
    (HERE / "videos").mkdir(exist_ok=True)
    if not arguments.report:
        with ThreadPoolExecutor(arguments.parallel) as pool:
            list(pool.map(train, arguments.only))
            jobs = [
                (task, method, seed)
                for method in ("translation", "random")
                for task in arguments.only
                for seed in seeds(task, method)
            ]
            list(pool.map(lambda job: learn(*job), jobs))
    translators, table = {}, []
    for task in PLANS:
        if (evaluation := evaluate(task, "translation")) is None:
            continue
        translators[task] = read_artifact(RUNS / f"{task}.translator.h5", "translator")
        for method in ("translation", "random", "oracle"):
            made = evaluation if method == "translation" else evaluate(task, method)
            if made is not None:
                table += rows(task, made)
        grid(task)
        shutil.copy(RUNS / f"{task}-c0.translation.png", HERE / f"paper-{task}-reward.png")
    fresh = list(translators)
    trained = [translator_row(task, artifact) for task, artifact in translators.items()]
    runs, costs = HERE / "paper.csv", HERE / "translators.csv"
    if set(fresh) == set(PLANS):
        plot(translators)
    report(
        write(runs, COLUMNS, table + kept(runs, fresh)), write(costs, TRANSLATOR_COLUMNS, trained + kept(costs, fresh))
    )


if __name__ == "__main__":
    main()
