"""Makes results/paper.csv and paper.md: the paper's experiment on a CPU, by the very commands that a user types.

    python results/tasks.py     # experts, and the oracle's runs
    python results/paper.py

Demonstrations in the paper's contexts, a compact translator a task, and in each unseen context a policy that learns
from the translation reward alone. Finished artifacts, in runs/paper, are not made again; --only takes one part of it.
"""

from __future__ import annotations

import argparse
import csv
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from commands import ifo
from scipy.stats import spearmanr

from artifacts import Artifact, read_artifact, tile_videos, write_mp4
from stages.simulation.gl import choose_backend
from stages.simulation.tasks import make_task
from stages.statistics import wilson

HERE = Path(os.path.relpath(Path(__file__).parent))
EXPERTS, RUNS = Path("runs/tasks"), Path("runs/paper")
SHOWN = 4  # contexts in a task's MP4 grid


@dataclass(frozen=True)
class Plan:
    """What is run on a task.

    Attributes:
        contexts: Unseen contexts, one learning run each.
        paper: The paper's success rate (method, oracle).
        random: Contexts in which the reward of a translator of random weights is learned from, too.
    """

    contexts: int
    paper: tuple[float, float]
    random: int = 0


PLANS = {
    "reach": Plan(10, (0.85, 0.90), random=5),
    "push": Plan(10, (0.85, 0.90)),
    "sweep": Plan(5, (1.0, 1.0)),
    "strike": Plan(5, (0.95, 1.0)),
}
NAMES = {"translation": "translation", "random": "translator of random weights", "oracle": "oracle"}
# What is known before learning -> 1 where more is better, else -1.
PROXIES = {"psnr": 1, "image_ratio": -1, "feature_ratio": -1, "tau_expert": 1, "tau_noisy": 1, "tau_returns": 1}
COLUMNS = (
    "task",
    "method",
    "context_seed",
    "initial_distance",
    "final_distance",
    "normalised_distance",
    "success_paper",
    "normalised_distance_deterministic",
    "success_deterministic",
    "samples",
    "translator_minutes",
    "learning_minutes",
    "psnr",
    "copy_psnr",
    "image_ratio",
    "feature_ratio",
    "tau_expert",
    "tau_noisy",
    "tau_random",
    "tau_returns",
)


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


def rows(task: str, method: str, evaluation: Path, translator_minutes: float) -> list[dict[str, object]]:
    """One row a run, from the evaluation artifact."""
    artifact = read_artifact(evaluation, "evaluation")
    threshold = make_task(task).success_threshold
    made = []
    for k, run in enumerate(artifact.config["runs"]):
        if run["context_seed"] >= PLANS[task].contexts:
            continue
        stochastic, calm = artifact["normalised_distance_stochastic"][k], artifact["normalised_distance"][k]
        metrics = {} if method == "oracle" else run["translation_metrics"]
        made.append(
            {
                "task": task,
                "method": method,
                "context_seed": run["context_seed"],
                "initial_distance": round(float(artifact["initial_distance"][k].mean()), 4),
                "final_distance": round(float(artifact["final_distance_stochastic"][k].mean()), 4),
                "normalised_distance": round(float(stochastic.mean()), 4),
                "success_paper": int(stochastic.mean() < threshold),
                "normalised_distance_deterministic": round(float(calm.mean()), 4),
                "success_deterministic": round(float((calm < threshold).mean()), 3),
                "samples": run["samples"],
                "translator_minutes": round(translator_minutes, 1) if method == "translation" else "",
                "learning_minutes": round(run["learning_minutes"], 2),
                **{name: round(metrics[name], 3) for name in COLUMNS[12:] if name in metrics},
            }
        )
    return made


def success_table(table: list[dict[str, object]]) -> list[str]:
    """Success rates a task, with intervals, beside the paper's."""
    lines = [
        "| task | runs | success, paper's criterion [95%] | deterministic episodes | distance left, mean | oracle: "
        "success, distance | the paper's: method, oracle |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for task, plan in PLANS.items():
        mine = [row for row in table if row["task"] == task and row["method"] == "translation"]
        oracle = [row for row in table if row["task"] == task and row["method"] == "oracle"]
        if not mine:
            lines.append(f"| {task} | not finished | | | | | |")
            continue
        succeeded = sum(int(str(row["success_paper"])) for row in mine)
        low, high = wilson(succeeded, len(mine))

        def mean(rows: list[dict[str, object]], name: str) -> float:
            return float(np.mean([float(str(row[name])) for row in rows]))

        lines.append(
            f"| {task} | {len(mine)} | {succeeded / len(mine):.2f} [{low:.2f}, {high:.2f}] "
            f"| {mean(mine, 'success_deterministic'):.2f} | {mean(mine, 'normalised_distance'):.3f} "
            f"| {mean(oracle, 'success_paper'):.2f}, {mean(oracle, 'normalised_distance'):.3f} "
            f"| {plan.paper[0]:.2f}, {plan.paper[1]:.2f} |"
        )
    return lines


def run_table(table: list[dict[str, object]]) -> list[str]:
    """Distances and rewards' quality, run by run."""
    lines = []
    for task in PLANS:
        for method in ("translation", "random", "oracle"):
            mine = [row for row in table if row["task"] == task and row["method"] == method]
            if mine:
                left = ", ".join(f"{float(str(row['normalised_distance'])):.2f}" for row in mine)
                lines.append(f"- {task}, {NAMES[method]}: {left}")
    return lines


def proxy_table(table: list[dict[str, object]]) -> list[str]:
    """Spearman's rank correlation of each figure known before learning with the distance left after it."""
    lines = ["| task | " + " | ".join(PROXIES) + " |", "| --- |" + " --- |" * len(PROXIES)]
    for task in PLANS:
        mine = [row for row in table if row["task"] == task and row["method"] == "translation"]
        if len(mine) < 5:
            continue
        cells = []
        for name, sign in PROXIES.items():
            pairs = [(sign * float(str(r[name])), -float(str(r["normalised_distance"]))) for r in mine if name in r]
            cells.append(f"{spearmanr(*zip(*pairs, strict=True)).statistic:.2f}" if len(pairs) > 2 else "-")
        lines.append(f"| {task} | " + " | ".join(cells) + " |")
    return lines


def translator_table(translators: dict[str, Artifact]) -> list[str]:
    """Held-out figures and cost of each translator."""
    lines = [
        "| task | demonstrations | steps | minutes, one thread | PSNR (copying), dB | SSIM (copying) | feature ratio |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for task, artifact in translators.items():
        m = {name: float(value) for name, value in artifact.group("metrics").items()}
        lines.append(
            f"| {task} | {artifact.config['demonstrations']} | {artifact.config['steps']} | {minutes(artifact):.0f} "
            f"| {m['psnr']:.2f} ({m['copy_psnr']:.2f}) | {m['ssim']:.3f} ({m['copy_ssim']:.3f}) "
            f"| {m['feature_ratio']:.2f} |"
        )
    return lines


def minutes(translator: Artifact) -> float:
    """Minutes that training took, its evaluations included."""
    return float(translator["curve/seconds"].sum() / 60)


def _png(draw: Callable, path: Path, panels: int) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, panels, figsize=(4.2 * panels, 3.6), dpi=110, squeeze=False)
    draw(axes[0])
    figure.tight_layout()
    figure.savefig(path, metadata={"Software": None})
    pyplot.close(figure)


def plots(translators: dict[str, Artifact]) -> None:
    """Learning curves of policies, and of translators."""

    def learning(axes: np.ndarray) -> None:
        for panel, task in zip(axes, PLANS, strict=True):
            for folder, colour, label in ((EXPERTS, "tab:grey", "oracle"), (RUNS, "tab:blue", "translation")):
                for seed in range(PLANS[task].contexts):
                    path = folder / f"{task}-c{seed}.policy.h5"
                    if path.exists():
                        policy = read_artifact(path, "policy")
                        x, y = policy["curve/samples"], policy["curve/normalised_distance"]
                        panel.plot(x, y, color=colour, alpha=0.7, linewidth=1, label=label if seed == 0 else None)
            panel.axhline(make_task(task).success_threshold, color="black", linestyle="--", linewidth=0.8)
            panel.set(title=task, xlabel="samples", ylabel="final / initial distance", ylim=(0, 2))
            panel.legend(fontsize=7)

    def translation(axes: np.ndarray) -> None:
        for task, artifact in translators.items():
            spent = np.cumsum(artifact["curve/seconds"]) / 60
            axes[0].plot(spent, artifact["curve/held_out/psnr"], label=task)
            axes[1].plot(spent, artifact["curve/held_out/feature_ratio"], label=task)
        for panel, name in zip(axes, ("held-out PSNR, dB", "feature ratio"), strict=True):
            panel.set(xlabel="minutes of training, one thread", ylabel=name)
            panel.legend(fontsize=8)

    _png(learning, HERE / "paper-learning.png", len(PLANS))
    if translators:
        _png(translation, HERE / "paper-translators.png", 2)


def grid(task: str) -> None:
    """An MP4 a task: mean translation, the true expert's video and the learned policy's, in unseen contexts."""
    found = []
    for seed in range(SHOWN):
        path = RUNS / f"{task}-c{seed}.translation.h5"
        if path.exists():
            artifact = read_artifact(path, "translation")
            frame, truth = artifact["context_frame"], artifact["expert_frames"]
            mean = np.clip(artifact["target_images"], 0, 255).round().astype(np.uint8)
            one = artifact["images"][0]
            found.append([np.repeat(frame[None], len(truth), axis=0), one, mean, truth])
    if found:
        labels = ["context", "translation", "mean of 200", "expert here"]
        write_mp4(HERE / "videos" / f"paper-{task}.mp4", tile_videos(found, labels=labels), fps=10)


def report(table: list[dict[str, object]], translators: dict[str, Artifact]) -> None:
    """Write paper.md."""
    text = [
        "# The paper's experiment on two CPU cores",
        "",
        "Made by `python results/paper.py` from evaluation artifacts; every run is in paper.csv. Demonstrations and "
        "learners in the paper's contexts (full circle of azimuths); contexts of learners were never demonstrated in. "
        "Policies learn from the translation reward alone, 60 iterations of 5,000 samples.",
        "",
        *success_table(table),
        "",
        "Final over initial distance of every run (mean over 100 episodes of the stochastic policy):",
        "",
        *run_table(table),
        "",
        "![learning curves](paper-learning.png)",
        "",
        "## Translators",
        "",
        *translator_table(translators),
        "",
        "![held-out curves](paper-translators.png)",
        "",
        *[f"- videos/paper-{task}.mp4: a single translation, the mean of 200, and the truth" for task in translators],
        "",
        "## Does the proxy predict the outcome?",
        "",
        "Spearman's rank correlation between what `ifo translate` knows before any learning and how near the goal the "
        "run then ends (1: the better the figure, the nearer):",
        "",
        *proxy_table(table),
        "",
    ]
    (HERE / "paper.md").write_text("\n".join(text))


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
    table: list[dict[str, object]] = []
    translators = {
        task: read_artifact(RUNS / f"{task}.translator.h5", "translator")
        for task in PLANS
        if (RUNS / f"{task}.translator.h5").exists()
    }
    for task, translator in translators.items():
        for method in ("translation", "random", "oracle"):
            evaluation = evaluate(task, method)
            if evaluation is not None:
                table += rows(task, method, evaluation, minutes(translator))
        grid(task)
        picture = RUNS / f"{task}-c0.translation.png"
        if picture.exists():
            shutil.copy(picture, HERE / f"paper-{task}-reward.png")
    with (HERE / "paper.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(table)
    plots(translators)
    report(table, translators)


if __name__ == "__main__":
    main()
