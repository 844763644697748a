"""Makes results/gps.html, gps.md and gps.csv: guided policy search beside TRPO at equal samples, on push-real.

    python results/gps.py

The true state is the cost, or the reward: what each makes of 200 episodes in each of sixteen contexts, guided policy
search also with three searches that begin apart. Finished artifacts, in runs/gps, are not made again; the page is of
all evaluations in results/gps.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from commands import ifo

from artifacts import stem_of
from stages.simulation.gl import choose_backend

HERE = Path(os.path.relpath(Path(__file__).parent))
RUNS, EVALUATIONS = Path("runs/gps"), HERE / "gps"
TASK = "push-real"
OPTIONS = ("--reward", "oracle", "--iterations", 20, "--episodes", 10)
LEARNERS = {
    "gps": ("--learner", "gps"),
    "starts": ("--learner", "gps", "--starts", 3),
    "trpo": ("--learner", "trpo"),
}


def learn(translation: Path, learner: str, seed: int) -> Path:
    """One run and its evaluation."""
    words = ("learn-policy", translation, *LEARNERS[learner], *OPTIONS, "--workers", 1, "--resume")
    policy = ifo(*words, out=RUNS / f"{TASK}-{learner}-c{seed}.policy.h5")
    return ifo("evaluate", policy, "--workers", 1, out=EVALUATIONS / f"{stem_of(policy)}.evaluation.h5")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parallel", type=int, default=2, help="runs side by side")
    parser.add_argument("--contexts", type=int, default=16)
    arguments = parser.parse_args()
    choose_backend()
    for folder in (RUNS, EVALUATIONS):
        folder.mkdir(parents=True, exist_ok=True)
    # Neither learner sees a video: a translator of random weights says which context is whose.
    demos = ifo("collect-demos", TASK, "-n", 16, out=RUNS / f"{TASK}.demos.h5")
    blank = ifo("train-translator", demos, "--steps", 0, out=RUNS / f"{TASK}.translator.h5")
    seeds = range(arguments.contexts)
    translations = [
        ifo("translate", blank, "--context-seed", seed, "--workers", 1, out=RUNS / f"{TASK}-c{seed}.translation.h5")
        for seed in seeds
    ]
    with ThreadPoolExecutor(arguments.parallel) as pool:
        jobs = [(translations[seed], learner, seed) for seed in seeds for learner in LEARNERS]
        list(pool.map(lambda job: learn(*job), jobs))
    page = HERE / "gps.html"
    page.unlink(missing_ok=True)
    ifo("report", EVALUATIONS, out=page)


if __name__ == "__main__":
    main()
