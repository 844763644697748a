"""Writes tests/fixtures/defaults.json: what every option resolves to, held fixed by test_defaults.py.

    python -m tests.stages.config.dump_defaults

Run it only where defaults are to change; the difference shows which.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from stages.config.presets import PRESETS, defaults
from stages.config.stages import ARCHITECTURES, HOUSEHOLD, LEARNERS, LOCAL_LEARNERS, STAGES, TASKS

FIXTURE = Path(__file__).parents[2] / "fixtures" / "defaults.json"
CHOICES = {
    "train-expert": LEARNERS,
    "learn-policy": LEARNERS + LOCAL_LEARNERS,
    "train-translator": ARCHITECTURES,
}
NAMED = (*TASKS, *HOUSEHOLD, "dm:reacher-easy", "dm:finger-turn_hard", "users_module:Lift")


def values(config: Any) -> dict[str, Any]:
    return {item.name: getattr(config, item.name) for item in dataclasses.fields(config)}


def dump() -> dict[str, Any]:
    """Of each preset and stage all values; of each task and choice those that differ, where some do."""
    presets: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for preset in PRESETS:
        for stage in STAGES:
            plain = values(defaults(preset, stage))
            presets[f"{preset} {stage}"] = plain
            for task in ("", *NAMED):
                for choice in ("", *CHOICES.get(stage, ())):
                    own = values(defaults(preset, stage, task, choice))
                    if different := {name: value for name, value in own.items() if value != plain[name]}:
                        others[f"{preset} {stage} {task or '-'} {choice or '-'}"] = different
    return {"presets": presets, "others": others}


if __name__ == "__main__":
    FIXTURE.write_text(json.dumps(dump(), indent=1) + "\n", encoding="utf-8")
