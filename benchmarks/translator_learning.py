"""Held-out PSNR of the compact translator against the paper's network with the paper's optimiser, at equal CPU time.

    ifo collect-demos reach --contexts paper -n 16384 --out runs/paper/reach.demos.h5
    python benchmarks/translator_learning.py runs/paper/reach.demos.h5 --minutes 30

Prints one JSON line. Both train on the same demonstrations, in one process on one thread, a step of the one that has
spent less CPU time at a time. The compact network's learning rate falls to the end of its time; the paper's stays.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import time
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import torch

from artifacts import read_artifact
from stages.config.presets import PRESETS
from stages.config.stages import TranslatorConfig
from stages.translation.evaluation import evaluate_translator
from stages.translation.training import TranslatorTraining

HELD_OUT = 128
WARM = 20  # steps that tell how many fit into the time


def trained(config: TranslatorConfig, frames: torch.Tensor) -> TranslatorTraining:
    return TranslatorTraining(config, frames[:-HELD_OUT], 0, "cpu")


def step(training: TranslatorTraining) -> float:
    """CPU seconds of one step."""
    start = time.process_time()
    training.train_step()
    return time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demos", type=Path, nargs="?", default=Path("runs/paper/reach.demos.h5"))
    parser.add_argument("--minutes", type=float, default=30, help="CPU minutes of each network")
    parser.add_argument("--points", type=int, default=3, help="evaluations on the way, the last at the end")
    arguments = parser.parse_args()
    if not arguments.demos.exists():
        parser.error(f"{arguments.demos}: no such file: collect demonstrations first, as above")
    torch.set_num_threads(1)
    frames = torch.from_numpy(read_artifact(arguments.demos, "demos")["frames"])
    compact = dataclasses.replace(PRESETS["quick"]["train-translator"])
    trial = trained(compact, frames)
    rate = sum(step(trial) for _ in range(WARM)) / WARM
    compact = dataclasses.replace(compact, steps=int(60 * arguments.minutes / rate))
    trainings = {
        "compact": trained(compact, frames),
        "paper": trained(PRESETS["paper"]["train-translator"], frames),
    }
    spent = dict.fromkeys(trainings, 0.0)
    curve: dict[str, list[float]] = {"minutes": [], "compact_psnr": [], "paper_psnr": []}
    figures: dict[str, float] = {}
    while min(spent.values()) < 60 * arguments.minutes:
        name = min(spent, key=lambda k: spent[k])
        spent[name] += step(trainings[name])
        if min(spent.values()) >= 60 * arguments.minutes * (len(curve["minutes"]) + 1) / arguments.points:
            curve["minutes"].append(round(min(spent.values()) / 60, 1))
            for arch, training in trainings.items():
                measured = evaluate_translator(training.average, frames[-HELD_OUT:], "cpu")
                curve[f"{arch}_psnr"].append(round(measured["psnr"], 2))
                figures |= {f"{arch}_feature_ratio": round(measured["feature_ratio"], 3)}
                figures |= {"copy_psnr": round(measured["copy_psnr"], 2)}
    gain = curve["compact_psnr"][-1] - curve["paper_psnr"][-1]
    steps = {f"{name}_steps": training.step for name, training in trainings.items()}
    print(json.dumps({"benchmark": "translator_learning", "gain_db": round(gain, 2), **figures, **steps, **curve}))


if __name__ == "__main__":
    main()
