"""Common defaults of the household tasks."""

from __future__ import annotations

from typing import Any

from stages.config.tasks.entry import TaskDefaults


def household(demos: int, fine_blur: float, rollouts: tuple[int, int]) -> TaskDefaults:
    """Return the defaults of a household task.

    Args:
        demos: Number of demonstrations to collect: as in the paper, except for the ladle.
        fine_blur: --fine-blur with guided policy search, in pixels.
        rollouts: Iterations of guided policy search and episodes per iteration, in preset quick.
    """
    # Exploration noise is small, because noise in seven joints moves the tool far.
    calm: dict[str, Any] = {"log_std": -1.2}
    # Full weight of early frames and a wide blur guide the tool to its target (results/LOG.md).
    seen = {**calm, "blur": 8.0, "fine_blur": fine_blur, "ramp": "none"}
    iterations, episodes = rollouts
    return {
        "toy": {"collect-demos": {"n": 32}, "learn-policy": {"gps": seen}},
        "quick": {
            "collect-demos": {"n": demos},
            "learn-policy": {"gps": {**seen, "iterations": iterations, "episodes": episodes}},
        },
        "paper": {"collect-demos": {"n": demos}, "learn-policy": {"gps": calm}},
    }
