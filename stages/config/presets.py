"""What options resolve to: presets, and what tasks, learners and networks need otherwise.

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

# What a learner or a network needs otherwise than the presets: preset -> stage -> learner or network -> fields.
_GPS: dict[str, Any] = {"kl": 1.0, "log_std": 0.0}
_GPS_FULL: dict[str, Any] = {**_GPS, "iterations": 20, "episodes": 10, "checkpoint_every": 1}
VARIANTS: TaskDefaults = {
    "toy": {
        "learn-policy": {"gps": {**_GPS, "iterations": 3, "episodes": 5}},
        "train-translator": {"real": {"lambda_align": 0.2}},
    },
    "quick": {"learn-policy": {"gps": _GPS_FULL}, "train-translator": {"real": {"lambda_align": 0.2}}},
    "paper": {
        "learn-policy": {"gps": _GPS_FULL},
        "train-translator": {"real": {"lambda_align": 0.2, "steps": 63_000}},
    },
}


@dataclass(frozen=True)
class Resolved:
    """A configuration, and for each of its fields who set it."""

    config: Any
    origins: dict[str, str]

    def with_(self, origin: str, values: Mapping[str, Any]) -> Resolved:
        """The same with other `values`, which `origin` set."""
        return Resolved(replace(self.config, **values), {**self.origins, **dict.fromkeys(values, origin)})


def resolve(stage: str, preset: str, task: str = "", choice: str = "", own: TaskDefaults | None = None) -> Resolved:
    """What the options of `stage` are where nobody gives any.

    Args:
        stage: Name of the stage.
        preset: Name of the preset.
        task: Name of the task; empty: none is known.
        choice: The learner or network that was chosen; empty: the one that preset and task have.
        own: What the task needs otherwise than the presets; None: look `task` up among ours.
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
    """The configuration of `stage` under `preset`, with what `task` and the learner or network need otherwise."""
    return resolve(stage, preset, task, choice, own).config


def changed(stage: str, config: Config) -> frozenset[str]:
    """Names of the fields whose value comes from no preset, task, learner or network of ours: somebody chose it."""
    known: dict[str, set[Any]] = {item.name: {getattr(type(config)(), item.name)} for item in fields(config)}
    choice = getattr(config, config.VARIANT) if config.VARIANT else ""
    for other in _unchosen(stage, choice) if stage in STAGES else ():
        for name in known:
            known[name].add(getattr(other, name))
    return frozenset(name for name, values in known.items() if getattr(config, name) not in values)


@lru_cache
def _unchosen(stage: str, choice: str) -> tuple[Any, ...]:
    """Every configuration of a stage in which nobody chose anything, or nothing but a learner or network."""
    cases = itertools.product(PRESETS, ("", *ENTRIES), {"", choice})
    return tuple({defaults(preset, stage, task, chosen) for preset, task, chosen in cases})
