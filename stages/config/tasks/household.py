"""Defaults that the household tasks share."""

from __future__ import annotations

from typing import Any

from stages.config.tasks.entry import TaskDefaults


def household(demos: int, fine_blur: float, rollouts: tuple[int, int]) -> TaskDefaults:
    """Defaults of a household task.

    Args:
        demos: Demonstrations to collect: as many as the paper has, but for the ladle.
        fine_blur: --fine-blur under guided policy search, in pixels.
        rollouts: Iterations of guided policy search, and episodes per iteration, in preset quick.
    """
    # Seven joints that all tremble move a tool far.
    calm: dict[str, Any] = {"log_std": -1.2}
    # Early frames and wide blurs lead to where the tool is to go (results/LOG.md).
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
