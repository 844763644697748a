"""An artifact in words: what it is in one sentence, its key figures, and values as text."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from artifacts import Artifact

KEY_FIGURES = ("metrics", "summary")  # groups in the configuration, or of datasets
CURVE = "curve"  # group of datasets with learning curves, whose last values are shown
LONGEST_VALUE = 2000  # characters
SHORT = 8  # maximum number of values of a dataset that are all shown
ELLIPSIS = "\N{HORIZONTAL ELLIPSIS}/"
# The folders of an absolute path: in the quotes that a shell needs around spaces, or after what precedes a path in a
# command or message.
QUOTED_FOLDERS = re.compile(r"(?<=')/(?:[^/'\n]*/)*")
FOLDERS = re.compile(r"(?:(?<=[\s\"=,;:(\[])|^)(?:~[^\s/]*)?/(?![/\s])(?:[^/\s]*/)*")
Shapes = Mapping[str, tuple[tuple[int, ...], np.dtype]]


def key_figures(artifact: Artifact) -> dict[str, Any]:
    """Return the metrics in the configuration and in datasets; for a long series, only its last value."""
    figures: dict[str, Any] = {}
    for group in KEY_FIGURES:
        found = artifact.config.get(group)
        if isinstance(found, dict):
            figures.update(found)
        for name in artifact.names(f"{group}/"):
            values = artifact[name]
            key = name.removeprefix(f"{group}/")
            if values.ndim == 0 or (values.ndim == 1 and 1 < values.size <= SHORT):
                figures[key] = values.tolist()
            elif values.ndim == 1 and values.size:
                figures[key] = values[-1].tolist()
    for name in artifact.names(f"{CURVE}/"):
        series = artifact[name]
        if series.ndim == 1 and series.size:
            figures[f"last {name.removeprefix(f'{CURVE}/')}"] = series[-1].tolist()
    return figures


def value_text(value: Any, rest: str = "--json shows all") -> str:
    """Return a JSON value as text, of limited length; `rest` says where the rest of a long one is."""
    text = _whole_value(value, rest)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]} ... ({rest})"


def _whole_value(value: Any, rest: str) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        if len(value) > SHORT and isinstance(value[0], dict):
            return f"{value_text(value[:1], rest)}, {len(value) - 1} more ({rest})"
        return ", ".join(value_text(item, rest) for item in value[:LONGEST_VALUE]) or "none"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def without_folders(text: str) -> str:
    """Return a text in which absolute paths are reduced to the names of their files.

    A page may be sent to others, who need not know the folders of the machine that made it.
    """
    return FOLDERS.sub(ELLIPSIS, QUOTED_FOLDERS.sub(ELLIPSIS, text))


def values_without_folders(value: Any) -> Any:
    """Return a JSON value in which texts that are absolute paths, or contain them, have lost their folders."""
    if isinstance(value, dict):
        return {without_folders(key): values_without_folders(item) for key, item in value.items()}
    if isinstance(value, list):
        return [values_without_folders(item) for item in value]
    if not isinstance(value, str):
        return value
    return f"{ELLIPSIS}{value.rpartition('/')[2]}" if value.startswith("/") else without_folders(value)


def sentence(artifact: Artifact) -> str:
    """Return what an artifact is, in one sentence."""
    return SENTENCES[artifact.kind](artifact.config, artifact.describe())


def place_of(config: Mapping[str, Any]) -> str:
    """Return the task or environment that a configuration names; empty if it names none."""
    environment = config.get("environment")
    if isinstance(environment, dict):
        return f"environment {environment.get('name')}"
    return f"task {config['task']}" if config.get("task") else ""


def _expert(config: Mapping[str, Any], shapes: Shapes) -> str:
    return (
        f"An expert{_in(config)}, a policy learned by {_word(config, 'learner')} from the task's own reward: it "
        "demonstrates the task."
    )


def _demos(config: Mapping[str, Any], shapes: Shapes) -> str:
    count, length, height, width = shapes["frames"][0][:4]
    return (
        f"{_counted(count, 'demonstration video')}{_in(config, 'of')}, without actions: {_counted(length, 'frame')} of "
        f"{width}x{height} pixels each."
    )


def _translator(config: Mapping[str, Any], shapes: Shapes) -> str:
    held_out, count = config.get("held_out_demonstrations", 0), config.get("demonstrations", 0)
    return (
        f"A translator of videos into other contexts{_in(config, 'of')}: network {_word(config, 'arch')}, trained for "
        f"{config.get('steps', 0):,} steps on {_counted(count - held_out, 'demonstration')}, with {held_out} held out."
    )


def _translation(config: Mapping[str, Any], shapes: Shapes) -> str:
    length, height, width = shapes["target_images"][0][:3]
    count = shapes["images"][0][0] if "images" in shapes else None
    mean = "demonstrations" if count is None else _counted(count, "demonstration")
    how = "without translation" if config.get("untranslated") else "translated into the learner's context"
    return (
        f"The target that a policy tracks{_in(config)}: the mean of {mean}, {how}; {_counted(length, 'frame')} of "
        f"{width}x{height} pixels."
    )


def _policy(config: Mapping[str, Any], shapes: Shapes) -> str:
    return f"A policy{_in(config)}, learned by {_word(config, 'learner')} with reward {_word(config, 'reward')}."


def _evaluation(config: Mapping[str, Any], shapes: Shapes) -> str:
    outcomes = [shape for name, (shape, _) in shapes.items() if "/" not in name and len(shape) == 2]
    runs, episodes = outcomes[0] if outcomes else (0, 0)
    policies = "policy" if runs == 1 else "policies"
    return (
        f"An evaluation of {runs} {policies}{_in(config)}, with {_counted(episodes, 'episode')} of the deterministic "
        "and as many of the stochastic policy."
    )


SENTENCES: dict[str, Callable[[Mapping[str, Any], Shapes], str]] = {
    "expert": _expert,
    "demos": _demos,
    "translator": _translator,
    "translation": _translation,
    "policy": _policy,
    "evaluation": _evaluation,
}


def _in(config: Mapping[str, Any], word: str = "in") -> str:
    place = place_of(config)
    return f" {word} {place}" if place else ""


def _word(config: Mapping[str, Any], name: str) -> str:
    return str(config.get(name) or "unknown")


def _counted(number: int, noun: str) -> str:
    return f"{number:,} {noun}" + ("" if number == 1 else "s")
