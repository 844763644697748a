"""What results/paper.py runs, and where its files lie."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

HERE = Path(os.path.relpath(Path(__file__).parent))
EXPERTS, RUNS = Path("runs/tasks"), Path("runs/paper")
SHOWN = 4  # contexts in a task's MP4 grid


@dataclass(frozen=True)
class Plan:
    """What is run on a task.

    Attributes:
        contexts: Unseen contexts, one learning run each.
        random: Contexts in which the reward of a translator of random weights is learned from, too.
    """

    contexts: int
    random: int = 0


PLANS = {
    "reach": Plan(10, random=5),
    "push": Plan(10),
    "sweep": Plan(5),
    "strike": Plan(10),
}
NAMES = {"translation": "translation", "random": "translator of random weights", "oracle": "oracle"}
# What is known before learning -> 1 where more is better, else -1.
PROXIES = {
    "psnr": 1,
    "image_ratio": -1,
    "feature_ratio": -1,
    "tau_expert": 1,
    "tau_noisy": 1,
    "tau_returns": 1,
    "tau_way": 1,
}
TRANSLATOR_COLUMNS = (
    "task",
    "demonstrations",
    "steps",
    "minutes",
    "psnr",
    "copy_psnr",
    "ssim",
    "copy_ssim",
    "feature_ratio",
)
