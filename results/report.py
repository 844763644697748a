"""Tables, plots and videos of results/paper.py, made from artifacts."""

from __future__ import annotations

import json

import numpy as np
from plan import HERE, NAMES, PLANS, PROXIES, RUNS, SHOWN
from scipy.stats import spearmanr

from artifacts import Artifact, read_artifact, tile_videos, write_mp4
from stages.reporting.intervals import wilson
from stages.reporting.paper import SUCCESS


def success_table(table: list[dict[str, object]]) -> list[str]:
    """Success rates a task, with intervals, beside the paper's."""
    lines = [
        "| task | runs | success, paper's criterion [95%] | deterministic episodes | distance left, mean | oracle: "
        "success, distance | the paper's: method, oracle |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for task in PLANS:
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
            f"| {SUCCESS[task, 'translation']:.2f}, {SUCCESS[task, 'oracle']:.2f} |"
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
        if len(mine) < 5:  # too few to rank
            continue
        cells = []
        for name, sign in PROXIES.items():
            pairs = [
                (sign * float(str(r[name])), -float(str(r["normalised_distance"])))
                for r in mine
                if r.get(name, "") != ""
            ]
            cells.append(f"{spearmanr(*zip(*pairs, strict=True)).statistic:.2f}" if len(pairs) > 2 else "-")
        lines.append(f"| {task} | " + " | ".join(cells) + " |")
    return lines


def translator_table(translators: list[dict[str, object]]) -> list[str]:
    """Held-out figures and cost of each translator."""
    lines = [
        "| task | demonstrations | steps | minutes, one thread | PSNR (copying), dB | SSIM (copying) | feature ratio |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in translators:
        m = {name: float(str(value)) for name, value in row.items() if name != "task"}
        lines.append(
            f"| {row['task']} | {row['demonstrations']} | {row['steps']} | {m['minutes']:.0f} "
            f"| {m['psnr']:.2f} ({m['copy_psnr']:.2f}) | {m['ssim']:.3f} ({m['copy_ssim']:.3f}) "
            f"| {m['feature_ratio']:.2f} |"
        )
    return lines


def minutes(translator: Artifact) -> float:
    """Minutes that training took, its evaluations included."""
    return float(translator["curve/seconds"].sum() / 60)


def plot(translators: dict[str, Artifact]) -> None:
    """Held-out curves of the translators."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(8.4, 3.6), dpi=110)
    for task, artifact in translators.items():
        spent = np.cumsum(artifact["curve/seconds"]) / 60
        axes[0].plot(spent, artifact["curve/held_out/psnr"], label=task)
        axes[1].plot(spent, artifact["curve/held_out/feature_ratio"], label=task)
    for panel, name in zip(axes, ("held-out PSNR, dB", "feature ratio"), strict=True):
        panel.set(xlabel="minutes of training, one thread", ylabel=name)
        panel.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(HERE / "paper-translators.png", metadata={"Software": None})
    pyplot.close(figure)


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


def cost() -> list[str]:
    """What benchmarks measured of cost: a learning run and a training of a translator, by part, beside the limits."""
    lines = (HERE / "benchmarks.jsonl").read_text().splitlines()
    found = {line["benchmark"]: line for line in map(json.loads, lines)}
    text = []
    if (run := found.get("learn_cost")) is not None:
        text.append(
            f"- A learning run of reach, 100 iterations of 12,500 samples on {run['workers']} cores: "
            f"{run['minutes_of_100_iterations']} minutes. Seconds an iteration: {_parts(run['seconds_an_iteration'])}. "
            f"{run['frames_per_s']:,} frames/s of the {run['limit_frames_per_s']:,} that drawing alone reaches; the "
            f"encoder runs at {run['encoder_gflops']:.0f} of a large matrix product's {run['limit_gemm_gflops']:.0f} "
            "GFLOP/s."
        )
    if (run := found.get("translator_cost")) is not None:
        text.append(
            f"- A translator, {run['steps']:,} steps on {run['threads']} core: {run['minutes']} minutes on an idle "
            f"machine. Milliseconds a step: {_parts(run['ms_a_step'])}. {run['gflops']:.0f} of a large matrix "
            f"product's {run['limit_gemm_gflops']:.0f} GFLOP/s."
        )
    if (run := found.get("translator_learning")) is not None:
        text.append(
            f"- The compact translator against the paper's network with the paper's optimiser, at equal CPU minutes "
            f"({', '.join(map(str, run['minutes']))}): {_listed(run['compact_psnr'])} dB against "
            f"{_listed(run['paper_psnr'])} dB held out, {run['gain_db']:+.1f} dB at the end (copying the context: "
            f"{run['copy_psnr']} dB; {run['compact_steps']:,} steps against {run['paper_steps']:,})."
        )
    return text


def _parts(parts: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in parts.items())


def _listed(values: list[float]) -> str:
    return ", ".join(f"{value:.1f}" for value in values)


def report(table: list[dict[str, object]], translators: list[dict[str, object]]) -> None:
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
        "Learning curves:",
        "",
        *[f"![learning curves of {row['task']}](paper-{row['task']}.evaluation.png)" for row in translators],
        "",
        "## Translators",
        "",
        *translator_table(translators),
        "",
        "![held-out curves](paper-translators.png)",
        "",
        "Videos: a single translation, the mean of 200, and the truth, in four contexts:",
        "",
        *[f"- [{row['task']}](videos/paper-{row['task']}.mp4)" for row in translators],
        "",
        "## Cost",
        "",
        "By the scripts in benchmarks/, whose output is benchmarks.jsonl:",
        "",
        *cost(),
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
