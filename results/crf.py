"""Makes results/crf.csv and crf.md: what compressing the footage costs, on push-real.

    python results/crf.py

The same demonstrations are taken twice: as MP4 files at crf 28 that are imported, and as frames that no codec has
seen. Each has a translator of its own, and a policy in each of five contexts. Finished artifacts, in runs/crf, are not
made again; the tables are of all evaluations in results/crf.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from commands import ifo, runs_of
from real import TRANSLATOR

from artifacts import ancestors, stem_of
from stages.reporting.rows import COLUMNS, Run, csv_text, row
from stages.simulation.gl import choose_backend

HERE = Path(os.path.relpath(Path(__file__).parent))
RUNS, EVALUATIONS = Path("runs/crf"), HERE / "crf"
TASK, CONTEXTS = "push-real", 5
FOOTAGE = {"crf28": "crf 28", "plain": "uncompressed"}


def film() -> dict[str, Path]:
    """Both sets of demonstrations, of one filming."""
    plain, videos = RUNS / "plain.demos.h5", RUNS / "videos"
    ifo("collect-demos", TASK, "--videos", videos, "--crf", 28, "--workers", 1, out=plain)
    return {"crf28": ifo("import-demos", videos, "--task", TASK, out=RUNS / "crf28.demos.h5"), "plain": plain}


def train(footage: str, demos: Path) -> Path:
    """Its translator."""
    words = ("train-translator", demos, *TRANSLATOR[""], "--workers", 1, "--resume")
    return ifo(*words, out=RUNS / f"{footage}.translator.h5")


def learn(footage: str, translator: Path, seed: int) -> Path:
    """One run and its evaluation."""
    where = ("--split", "all", "--context-seed", seed, "--workers", 1)
    translation = ifo("translate", translator, *where, out=RUNS / f"{footage}-c{seed}.translation.h5")
    how = ("--learner", "gps", "--workers", 1, "--resume")
    policy = ifo("learn-policy", translation, *how, out=RUNS / f"{footage}-c{seed}.policy.h5")
    return ifo("evaluate", policy, "--workers", 1, out=EVALUATIONS / f"{stem_of(policy)}.evaluation.h5")


def held_out_psnr(runs: list[Run]) -> str:
    """Of the translator that all runs learned from; a dash if it is not there any more, or another has its name."""
    found = {
        item.parent.sha256: item.artifact
        for run in runs
        if run.policy is not None
        for item in ancestors(run.evaluation, [run.policy], check=True)
        if item.parent.kind == "translator"
    }
    [translator] = found.values() if len(found) == 1 else [None]
    return "-" if translator is None else f"{translator['curve/held_out/psnr'][-1]:.1f}"


def markdown(cells: dict[str, list[Run]]) -> str:
    """The table of cells."""
    contexts = range(max(len(runs) for runs in cells.values()))
    lines = [
        "<!-- made by results/crf.py -->",
        "# Compressed footage: push-real",
        "",
        f"| footage | held-out PSNR (dB) | success | mean | {' | '.join(f'context {c}' for c in contexts)} |",
        f"| --- | ---: | ---: | ---: |{' ---: |' * len(contexts)}",
    ]
    for footage, runs in cells.items():
        left = [run.normalised_distance for run in runs]
        numbers = (
            held_out_psnr(runs),
            f"{np.mean([run.success for run in runs]):.2f}",
            *(f"{x:.2f}" for x in (np.mean(left), *left)),
        )
        lines.append(f"| {FOOTAGE[footage]} | {' | '.join(numbers)} |")
    lines += ["", "Fractions of the initial distance that are left; a run with less than a quarter succeeds."]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parallel", type=int, default=2, help="runs side by side")
    arguments = parser.parse_args()
    choose_backend()
    for folder in (RUNS, EVALUATIONS):
        folder.mkdir(parents=True, exist_ok=True)
    demos = film()
    with ThreadPoolExecutor(arguments.parallel) as pool:
        translators = dict(zip(FOOTAGE, pool.map(lambda footage: train(footage, demos[footage]), FOOTAGE), strict=True))
        jobs = [(footage, translators[footage], seed) for seed in range(CONTEXTS) for footage in FOOTAGE]
        list(pool.map(lambda job: learn(*job), jobs))
    cells = {
        footage: [run for path in sorted(EVALUATIONS.glob(f"{footage}-c*.evaluation.h5")) for run in runs_of(path)]
        for footage in FOOTAGE
    }
    rows = [{"footage": FOOTAGE[footage], **row(run)} for footage, runs in cells.items() for run in runs]
    (HERE / "crf.csv").write_text(csv_text(("footage", *COLUMNS), rows), encoding="utf-8", newline="")
    (HERE / "crf.md").write_text(markdown(cells), encoding="utf-8")


if __name__ == "__main__":
    main()
