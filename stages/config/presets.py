"""Defaults of options: presets, and the different defaults of tasks, learners and networks.

Later layers win: the class of the stage, the preset, the task, the learner or network, the task with that learner or
network, a file of options, the command line. Light imports only.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

from stages.config.fields import Config
from stages.config.stages import (
    STAGES,
    DemosConfig,
    EvaluateConfig,
    ExpertConfig,
    PolicyConfig,
    TranslateConfig,
    TranslatorConfig,
)
from stages.config.tasks import ENTRIES, own_defaults
from stages.config.tasks.entry import TaskDefaults

DEFAULT_PRESET = "quick"
EXPERT_LEARNING: dict[str, Any] = {"iterations": 60, "gae_lambda": 0.95}

PRESETS: dict[str, dict[str, Config]] = {
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
        "train-translator": TranslatorConfig(videos=8, groups=2),
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

# Defaults of a learner or a network that differ from the presets: preset -> stage -> learner or network -> fields.
_GPS: dict[str, Any] = {"kl": 1.0, "log_std": 0.0}
_GPS_FULL: dict[str, Any] = {**_GPS, "iterations": 20, "episodes": 10, "checkpoint_every": 1}
_REAL: dict[str, Any] = {"lambda_align": 0.2}
VARIANTS: TaskDefaults = {
    "toy": {
        "learn-policy": {"gps": {**_GPS, "iterations": 3, "episodes": 5}},
        "train-translator": {"real": _REAL},
    },
    "quick": {
        "learn-policy": {"gps": _GPS_FULL},
        "train-translator": {"real": _REAL | {"videos": 16, "groups": 1}},
    },
    "paper": {
        "learn-policy": {"gps": _GPS_FULL},
        "train-translator": {"real": _REAL | {"steps": 63_000}},
    },
}


@dataclass(frozen=True)
class Resolved:
    """A configuration, and the origin of the value of each field."""

    config: Any
    origins: dict[str, str]

    def with_(self, origin: str, values: Mapping[str, Any]) -> Resolved:
        """Return the same configuration with other `values`, whose origin is `origin`."""
        return Resolved(replace(self.config, **values), {**self.origins, **dict.fromkeys(values, origin)})


def resolve(stage: str, preset: str, task: str = "", choice: str = "", own: TaskDefaults | None = None) -> Resolved:
    """Return the defaults of the options of `stage`.

    Args:
        stage: Name of the stage.
        preset: Name of the preset.
        task: Name of the task; empty: unknown.
        choice: The learner or network that the user chose; empty: the default of preset and task.
        own: The task's own defaults; None: those of the built-in task `task`.
    """
    own = own_defaults(task) if own is None else own
    plain = STAGES[stage]()
    config = PRESETS[preset][stage]
    changed_by_preset = [item.name for item in fields(plain) if getattr(config, item.name) != getattr(plain, item.name)]
    origins = {item.name: "default" for item in fields(plain)}
    resolved = Resolved(config, origins | dict.fromkeys(changed_by_preset, f"preset {preset}"))
    of_task = own.get(preset, {}).get(stage, {})
    resolved = resolved.with_(f"task {task}", _without_variants(of_task))
    if config.VARIANT:
        chosen = choice or getattr(resolved.config, config.VARIANT)
        for origin, mapping in (
            (f"{config.VARIANT} {chosen}", VARIANTS[preset].get(stage, {})),
            (f"task {task} with {chosen}", of_task),
        ):
            resolved = resolved.with_(origin, mapping.get(chosen, {}))
    return resolved


def _without_variants(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if not isinstance(value, Mapping)}


def defaults(preset: str, stage: str, task: str = "", choice: str = "", own: TaskDefaults | None = None) -> Any:
    """Return the default configuration of `stage` for a preset, a task and a learner or network."""
    return resolve(stage, preset, task, choice, own).config


def changed(stage: str, config: Config) -> frozenset[str]:
    """Return the names of the fields whose value is not a default of any preset, built-in task, learner or network."""
    known: dict[str, set[Any]] = {item.name: {getattr(type(config)(), item.name)} for item in fields(config)}
    choice = getattr(config, config.VARIANT) if config.VARIANT else ""
    for other in _unchosen(stage, choice) if stage in STAGES else ():
        for name in known:
            known[name].add(getattr(other, name))
    return frozenset(name for name, values in known.items() if getattr(config, name) not in values)


@lru_cache
def _unchosen(stage: str, choice: str) -> tuple[Any, ...]:
    """Return every configuration of a stage that consists of defaults, with or without a chosen learner or network."""
    cases = itertools.product(PRESETS, ("", *ENTRIES), {"", choice})
    return tuple({defaults(preset, stage, task, chosen) for preset, task, chosen in cases})
