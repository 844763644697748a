"""Demonstrators of Gymnasium environments: any policy that a user names."""

from __future__ import annotations

import importlib
import json
import os
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from artifacts import sha256_of
from stages.environments.making import EnvironmentFault, module_file
from stages.simulation.blame import failure

# The algorithm that loads a policy of Stable-Baselines3, by the module of its class.
ALGORITHMS = {
    "stable_baselines3.common.policies": "stable_baselines3:PPO",
    "stable_baselines3.sac.policies": "stable_baselines3:SAC",
    "stable_baselines3.td3.policies": "stable_baselines3:TD3",
    "sb3_contrib.tqc.policies": "sb3_contrib:TQC",
}


@dataclass(frozen=True)
class Demonstrator:
    """A policy to film.

    Attributes:
        act: Function of an observation that returns an action.
        begin: Function that is called at the start of every episode.
    """

    act: Callable[[Any], Any]
    begin: Callable[[], Any]


def load_demonstrator(name: str) -> Demonstrator:
    """Return the policy called `name`.

    Args:
        name: `MODULE:ATTR`, a function of the observation, or a class or object with `predict` (as in
            Stable-Baselines3) or `get_action` (as in Meta-World); or the path of a model saved by Stable-Baselines3
            (`.zip`). Both run code of the user. If the object has `reset`, it is called at the start of every episode.

    Raises:
        EnvironmentFault: There is no such policy, or its code fails.
    """
    try:
        policy = _saved(name) if name.endswith(".zip") else _named(name)
    except EnvironmentFault:
        raise
    except (Exception, SystemExit) as error:
        raise EnvironmentFault(
            f"demonstrator {name}: cannot be loaded {failure(error, [name.partition(':')[0]])}"
        ) from error
    begin = getattr(policy, "reset", lambda: None)
    if hasattr(policy, "predict"):
        return Demonstrator(lambda observation: policy.predict(observation, deterministic=True)[0], begin)
    if hasattr(policy, "get_action"):
        return Demonstrator(policy.get_action, begin)
    if not callable(policy):
        raise EnvironmentFault(
            f"demonstrator {name}: is a {type(policy).__name__}, expected a function of an observation, or an object "
            "with predict or get_action"
        )
    return Demonstrator(policy, begin)


def demonstrator_digest(name: str) -> dict[str, str]:
    """The SHA-256 of the demonstrator's file, as `{"demonstrator_code": ...}`; empty if it has none."""
    path = name if name.endswith(".zip") else module_file(name)
    return {"demonstrator_code": sha256_of(path)} if path and os.path.isfile(path) else {}


def _named(name: str) -> Any:
    module, colon, attribute = name.partition(":")
    if not colon or not attribute:
        raise EnvironmentFault(f"demonstrator {name}: expected MODULE:ATTR, or a file of Stable-Baselines3 (.zip)")
    policy = getattr(importlib.import_module(module), attribute, None)
    if policy is None:
        raise EnvironmentFault(f"demonstrator {name}: the module {module} has no {attribute}")
    return policy() if isinstance(policy, type) else policy


def _saved(path: str) -> Any:
    with zipfile.ZipFile(path) as file:
        described = json.loads(file.read("data"))
    module = str(described.get("policy_class", {}).get("__module__", ""))
    if module not in ALGORITHMS:
        raise EnvironmentFault(
            f"demonstrator {path}: has a policy of {module or 'an unknown class'}, expected one of "
            f"{', '.join(ALGORITHMS)}; or write a function that loads it, and name that with MODULE:ATTR"
        )
    package, _, algorithm = ALGORITHMS[module].partition(":")
    return getattr(importlib.import_module(package), algorithm).load(path, device="cpu")
