"""Makes results/quick.csv: the quick preset's reach, run by run, by the very commands that a user types.

    ifo collect-demos reach --preset quick | ifo train-translator
    python results/quick.py runs/reach.translator.h5

Methods: `translation` (the paper's reward), `random` (the same from a translator of random weights), `oracle` (the true
distance) and `video` (the true expert's video as target, a perfect translation). The first two run in five unseen
narrow contexts, the last two in ten unseen paper contexts. Finished artifacts are not made again.
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from artifacts import read_artifact

HERE = Path(os.path.relpath(Path(__file__).parent))
# Method -> (reward, contexts, context seeds).
METHODS = {
    "translation": ("translation", "narrow", range(5)),
    "random": ("translation", "narrow", range(5)),
    "oracle": ("oracle", "paper", range(10)),
    "video": ("video", "paper", range(10)),
}
COLUMNS = (
    "task",
    "method",
    "contexts",
    "context_seed",
    "initial_distance",
    "final_distance",
    "normalised_distance",
    "success_paper",
    "normalised_distance_deterministic",
    "success_deterministic",
    "samples",
    "learning_minutes",
    "psnr",
    "copy_psnr",
    "image_ratio",
    "feature_ratio",
)


def ifo(*words: object, out: Path) -> Path:
    """Run one command, unless its artifact is there already."""
    if not out.exists():
        command = [sys.executable, "-m", "ifo_cli.main", *map(str, words), "--out", str(out)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return out


def learn(method: str, seed: int, translator: Path, folder: Path) -> Path:
    """Translate into one context and learn there; returns the policy."""
    reward, contexts, _ = METHODS[method]
    # Oracle and video learn from the same translation artifact: made once.
    shared = "truth" if method in ("oracle", "video") else method
    translation = folder / f"{shared}-c{seed}.translation.h5"
    words = ("translate", translator, "--contexts", contexts, "--context-seed", seed, "--workers", 1)
    ifo(*words, out=translation)
    policy = folder / f"{method}-c{seed}.policy.h5"
    return ifo("learn-policy", translation, "--reward", reward, "--workers", 1, "--resume", out=policy)


def rows(method: str, evaluation: Path) -> list[dict[str, object]]:
    """One row a run, from the evaluation artifact."""
    artifact = read_artifact(evaluation, "evaluation")
    made = []
    for k, run in enumerate(artifact.config["runs"]):
        stochastic = float(artifact["normalised_distance_stochastic"][k].mean())
        metrics = run["translation_metrics"] if METHODS[method][0] == "translation" else {}
        made.append(
            {
                "task": artifact.config["task"],
                "method": method,
                "contexts": run["contexts"],
                "context_seed": run["context_seed"],
                "initial_distance": round(float(artifact["initial_distance"][k].mean()), 4),
                "final_distance": round(float(artifact["final_distance_stochastic"][k].mean()), 4),
                "normalised_distance": round(stochastic, 4),
                "success_paper": int(stochastic < 0.5),
                "normalised_distance_deterministic": round(float(artifact["normalised_distance"][k].mean()), 4),
                "success_deterministic": round(float((artifact["normalised_distance"][k] < 0.5).mean()), 3),
                "samples": run["samples"],
                "learning_minutes": round(run["learning_minutes"], 2),
                **{name: round(metrics[name], 3) for name in COLUMNS[-4:] if name in metrics},
            }
        )
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("translator", type=Path)
    parser.add_argument("--parallel", type=int, default=2, help="runs side by side")
    arguments = parser.parse_args()
    folder = arguments.translator.parent / "quick"
    folder.mkdir(exist_ok=True)
    demos = read_artifact(arguments.translator, "translator").parent("demos").path
    random = ifo("train-translator", demos, "--steps", 0, out=folder / "random.translator.h5")
    translators = {method: random if method == "random" else arguments.translator for method in METHODS}
    jobs = [(method, seed) for method, (_, _, seeds) in METHODS.items() if method != "video" for seed in seeds]
    later = [("video", seed) for seed in METHODS["video"][2]]
    table: list[dict[str, object]] = []
    with ThreadPoolExecutor(arguments.parallel) as pool:
        policies = list(pool.map(lambda job: learn(*job, translators[job[0]], folder), jobs))
        policies += pool.map(lambda job: learn(*job, translators[job[0]], folder), later)
    for method in METHODS:
        mine = [policy for (name, _), policy in zip(jobs + later, policies, strict=True) if name == method]
        evaluation = HERE / f"quick-{method}.evaluation.h5"
        evaluation.unlink(missing_ok=True)
        ifo("evaluate", *mine, out=evaluation)
        table += rows(method, evaluation)
    with (HERE / "quick.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(table)


if __name__ == "__main__":
    main()
