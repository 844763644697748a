"""Presets: every stage's defaults in one place, and what tasks, learners and architectures need otherwise.

As `stages.config.stages`, this module imports nothing heavy.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stages.config.stages import (
    HOUSEHOLD,
    LOCAL_LEARNERS,
    DemosConfig,
    EvaluateConfig,
    ExpertConfig,
    PolicyConfig,
    TranslateConfig,
    TranslatorConfig,
)

DEFAULT_PRESET = "quick"
EXPERT_LEARNING: dict[str, Any] = {"iterations": 60, "gae_lambda": 0.95}

PRESETS: dict[str, dict[str, Any]] = {
    "toy": {
        "train-expert": ExpertConfig(iterations=4, episodes=64, test_contexts=20, test_episodes=4),
        "collect-demos": DemosConfig(n=64, contexts="narrow", keep_failures=True),
        "train-translator": TranslatorConfig(
            steps=30, videos=8, frames=2, held_out=8, evaluate_every=15, checkpoint_every=15
        ),
        "translate": TranslateConfig(n=8),
        "learn-policy": PolicyConfig(iterations=3, episodes=16, checkpoint_every=1),
        "evaluate": EvaluateConfig(episodes=8),
    },
    "quick": {
        "train-expert": ExpertConfig(**EXPERT_LEARNING),
        "collect-demos": DemosConfig(n=16384),
        "train-translator": TranslatorConfig(),
        "translate": TranslateConfig(),
        "learn-policy": PolicyConfig(iterations=60, episodes=100),
        "evaluate": EvaluateConfig(),
    },
    "paper": {
        "train-expert": ExpertConfig(**EXPERT_LEARNING),
        "collect-demos": DemosConfig(n=3000),
        "train-translator": TranslatorConfig(
            arch="paper",
            steps=131_000,
            videos=100,
            frames=1,
            learning_rate=1e-4,
            schedule="constant",
            lambda_align=0.02,
            weight_decay=0.0,
            mirror=False,
            rec_frames=0,
            swap_colours=False,
            ema=0.0,
            evaluate_every=1000,
            checkpoint_every=5000,
        ),
        "translate": TranslateConfig(),
        "learn-policy": PolicyConfig(kl=0.01, gae_lambda=1.0, hidden=32, image_weight=1.0, blur=0.0),
        "evaluate": EvaluateConfig(episodes=250),
    },
}

# What a task needs otherwise than its preset: task, or prefix of tasks, -> preset -> stage -> fields.
_SUITE = {"learner": "sac", "hidden": 128, "discount": 0.99, "test_contexts": 50, "test_episodes": 4}
# Demonstrations, as many as the paper has but for the ladle, where it has 60: with 60 translators are overfitted.
_FILMED = dict(zip(HOUSEHOLD, (135, 85, 100, 180), strict=True))
_ONE_COLOUR: dict[str, Any] = {"swap_colours": False}
_STRIKE: dict[str, dict[str, Any]] = {"train-expert": {"iterations": 200}, "train-translator": _ONE_COLOUR}
TASK_DEFAULTS: dict[str, dict[str, dict[str, dict[str, Any]]]] = {
    "push": {"*": {"train-expert": {"iterations": 150}, "train-translator": _ONE_COLOUR}},
    "sweep": {"*": {"train-expert": {"iterations": 100}, "train-translator": _ONE_COLOUR}},
    "strike": {
        # R_feat bars the way to the ball (results/LOG.md).
        "*": {**_STRIKE, "learn-policy": {"image_weight": 8.0}},
        "paper": _STRIKE,
    },
    **{task: {"*": {"collect-demos": {"n": n}}, "toy": {"collect-demos": {"n": 32}}} for task, n in _FILMED.items()},
    "dm:": {
        "*": {
            "train-expert": {**_SUITE, "iterations": 60, "episodes": 4, "updates": 0.25},
            "collect-demos": {"n": 1024},
            "learn-policy": {"iterations": 100, "episodes": 20},
            "evaluate": {"episodes": 20},
        },
        "toy": {
            "train-expert": {**_SUITE, "iterations": 2, "episodes": 2, "test_contexts": 4, "test_episodes": 2},
            "collect-demos": {"n": 32},
            "learn-policy": {"iterations": 2, "episodes": 4},
            "evaluate": {"episodes": 2},
        },
    },
}
# What a learner or an architecture needs otherwise than the preset and the task have it: it -> preset -> fields.
CHOICE_DEFAULTS: dict[str, dict[str, dict[str, Any]]] = {
    "gps": {
        "*": {"iterations": 20, "episodes": 10, "kl": 1.0, "log_std": 0.0, "checkpoint_every": 1},
        "toy": {"iterations": 3, "episodes": 5, "kl": 1.0, "log_std": 0.0},
    },
    "real": {"*": {"lambda_align": 0.2}, "paper": {"lambda_align": 0.2, "steps": 63_000}},
}


def defaults(preset: str, stage: str, task: str = "", choice: str = "") -> Any:
    """The configuration of `stage` under `preset`, with what `task` and the learner or architecture need otherwise."""
    config = PRESETS[preset][stage]
    for prefix, presets in TASK_DEFAULTS.items():
        if task == prefix or (prefix.endswith(":") and task.startswith(prefix)):
            own = presets.get(preset, presets["*"] if preset != "toy" else {})
            config = replace(config, **own.get(stage, {}))
    if choice in CHOICE_DEFAULTS:
        config = replace(config, **CHOICE_DEFAULTS[choice].get(preset, CHOICE_DEFAULTS[choice]["*"]))
    if choice in LOCAL_LEARNERS and task in HOUSEHOLD:
        config = replace(config, log_std=-1.2)  # Seven joints that all tremble move a tool far.
        if preset != "paper":  # Early frames and wide blurs lead to where the tool is to go (results/LOG.md).
            fine = 0.0 if task == "push-real" else 3.0  # One large can is seen well enough under a wide blur.
            config = replace(config, blur=8.0, fine_blur=fine, ramp="none")
        if preset == "quick":  # 500 episodes at most, as results/real.py has it
            rollouts = (25, 20) if task == "push-real" else (50, 10)
            config = replace(config, iterations=rollouts[0], episodes=rollouts[1])
    return config
