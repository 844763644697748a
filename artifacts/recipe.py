"""Recipes: the requested stage, configuration, seed and inputs of an artifact. Equal recipes give equal artifacts."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from artifacts.schema import Manifest, json_values
from artifacts.store import Artifact, content_of

OLD = "made by an older ifo"
UNKNOWN = "no record of what it was made with"


def recipe_of(stage: str, config: Any, seed: int, parents: Sequence[str | Path | Artifact] = ()) -> dict[str, Any]:
    """Return the recipe of a run as JSON values, for `write_artifact(..., recipe=...)`.

    Args:
      stage: Name of the stage, as on the command line.
      config: The stage's complete requested configuration: a dataclass or a mapping.
      seed: Seed of the run.
      parents: The run's input artifacts.

    Raises:
      ArtifactError: A parent cannot be read.
    """
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        config = dataclasses.asdict(config)
    recipe = {
        "stage": stage,
        "config": dict(config),
        "seed": int(seed),
        "parents": [parent.content if isinstance(parent, Artifact) else content_of(parent) for parent in parents],
    }
    return dict(json_values(recipe))


def recipe_difference(artifact: Artifact | Manifest, recipe: Mapping[str, Any]) -> list[str]:
    """Return the differences between a run and the run that made an artifact; empty if there are none.

    Args:
      artifact: The existing artifact, or its manifest.
      recipe: Recipe of the run, from `recipe_of`.

    Returns:
      `stage`, or else the names of configuration keys (sorted), then `seed`, then `input file`. If the artifact does
      not record its recipe, one entry that says so.
    """
    manifest = artifact.manifest if isinstance(artifact, Artifact) else artifact
    found = manifest.recipe
    if not found:
        return [UNKNOWN if manifest.content else OLD]
    if found.get("stage") != recipe["stage"]:
        return ["stage"]
    before, now = found.get("config", {}), recipe["config"]
    different = sorted(key for key in before.keys() | now.keys() if _differ(before, now, key))
    if found.get("seed") != recipe["seed"]:
        different.append("seed")
    if found.get("parents") != recipe["parents"]:
        different.append("input file")
    return different


def _differ(before: Mapping[str, Any], now: Mapping[str, Any], key: str) -> bool:
    """Return whether two mappings of JSON values differ in a key; NaN equals NaN, and 1 equals 1.0."""
    if key not in before or key not in now:
        return True
    a, b = before[key], now[key]
    return bool(a != b) and json.dumps(a) != json.dumps(b)  # NaN differs from itself, but not as text.
