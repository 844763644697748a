"""Makes results/tasks.csv: the four tasks' experts, and learning from the true distance, by the commands a user types.

    python results/tasks.py

Trains each task's expert from scratch (`ifo train-expert TASK`), collects demonstrations and keeps their contact sheet,
and learns from the oracle in ten unseen paper contexts. Finished artifacts, in runs/tasks, are not made again.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from commands import ifo, runs_of

from artifacts import read_artifact
from stages.config.stages import TASKS
from stages.reporting.rows import csv_text, row
from stages.simulation.gl import choose_backend
from stages.simulation.registry import make_task
from stages.train_expert import CONSISTENT_SPREAD

HERE = Path(os.path.relpath(Path(__file__).parent))
RUNS = Path("runs/tasks")
CONTEXTS = range(10)
DEMOS = 3000
ORACLE_COLUMNS = (
    *("task", "method", "context_seed", "contexts", "normalised_distance", "success_paper"),
    *("normalised_distance_deterministic", "success_deterministic", "samples", "minutes"),
)


def learn(task: str, seed: int, translator: Path) -> Path:
    """A policy that learned from the true distance in one paper context."""
    words = ("translate", translator, "--contexts", "paper", "--context-seed", seed, "--n", 2, "--workers", 1)
    translation = ifo(*words, out=RUNS / f"{task}-c{seed}.translation.h5")
    words = ("learn-policy", translation, "--reward", "oracle", "--workers", 1, "--resume")
    return ifo(*words, out=RUNS / f"{task}-c{seed}.policy.h5")


def expert_row(task: str, path: Path) -> dict[str, object]:
    """What the expert's own test measured."""
    artifact = read_artifact(path, "expert")
    distances, spread = artifact["test/normalised_distance"], artifact["test/spread"].max(axis=1)
    made = make_task(task)
    return {
        "task": task,
        "method": "expert",
        "context_seed": "",
        "contexts": len(distances),
        "normalised_distance": round(float(distances.mean()), 4),
        "success_paper": round(float((distances < made.success_threshold).mean()), 4),
        "kept": round(float((distances < made.expert_threshold).mean()), 4),
        "spread_rad": round(float(np.median(spread)), 4),
        "consistent": round(float((spread < CONSISTENT_SPREAD).mean()), 4),
        "samples": int(artifact["curve/samples"][-1]),
        "minutes": round(float(artifact["curve/seconds"].sum() / 60), 2),
    }


def oracle_rows(path: Path) -> list[dict[str, object]]:
    """One row per run, from the evaluation artifact."""
    rows = []
    for run in runs_of(path, ("--reward", "oracle")):
        known = {**row(run), "contexts": 1, "minutes": row(run)["learning_minutes"]}
        rows.append({name: known[name] for name in ORACLE_COLUMNS})
    return rows


def plot(experts: dict[str, Path]) -> None:
    """Learning curves of the experts: normalised final distance over samples."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4.5), dpi=120)
    for task, path in experts.items():
        artifact = read_artifact(path, "expert")
        axes.plot(artifact["curve/samples"], artifact["curve/normalised_distance"], label=task)
    axes.set(
        xlabel="samples", ylabel="final distance / initial distance", yscale="log", title="experts, paper contexts"
    )
    axes.legend()
    figure.tight_layout()
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    (HERE / "experts.png").write_bytes(drawn.getvalue())


def main() -> None:
    choose_backend()
    RUNS.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(arguments.parallel) as pool:
        made = pool.map(lambda task: ifo("train-expert", task, "--workers", 1, out=RUNS / f"{task}.expert.h5"), TASKS)
        experts = dict(zip(TASKS, made, strict=True))
    table: list[dict[str, object]] = [expert_row(task, path) for task, path in experts.items()]
    policies: dict[str, list[Path]] = {}
    for task, expert in experts.items():
        words = ("collect-demos", task, "--expert", expert, "-n", DEMOS, "--contexts", "paper")
        demos = ifo(*words, out=RUNS / f"{task}.demos.h5")
        shutil.copy(demos.with_name(f"{task}.demos.png"), HERE / f"{task}.demos.png")
        # The oracle needs no translator; learn-policy needs a translation to know its context from.
        blank = ifo("train-translator", demos, "--steps", 0, out=RUNS / f"{task}.translator.h5")
        with ThreadPoolExecutor(arguments.parallel) as pool:
            policies[task] = list(pool.map(lambda seed, t=task, b=blank: learn(t, seed, b), CONTEXTS))
        evaluation = HERE / f"oracle-{task}.evaluation.h5"
        evaluation.unlink(missing_ok=True)
        table += oracle_rows(ifo("evaluate", *policies[task], out=evaluation))
    plot(experts)
    columns = list(dict.fromkeys(name for row in table for name in row))
    (HERE / "tasks.csv").write_text(csv_text(columns, table), encoding="utf-8", newline="")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parallel", type=int, default=2, help="runs side by side")
    arguments = parser.parse_args()
    main()
