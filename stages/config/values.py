"""Checks of values for configuration fields that come from a file of options or from a user's task."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from stages.config.fields import Config, one_of, wrong_value
from stages.config.presets import PRESETS
from stages.config.stages import STAGES
from stages.config.tasks.entry import TaskDefaults

KINDS = {int: "a whole number", float: "a number", bool: "true or false", str: "text", Path: "text"}
NO_NUL = "expected text without NUL characters"


def checked_value(config_class: type, name: str, value: Any) -> Any:
    """Return `value`, converted to the type of the field `name` of a configuration class.

    Raises:
        ValueError: There is no such field, or the value is invalid for it; the message begins with `expected`.
    """
    found = {item.name: item for item in dataclasses.fields(config_class)}
    if name not in found:
        raise ValueError(f"expected {meant(name, found)}")
    kind = get_type_hints(config_class)[name]
    if get_origin(kind) is tuple:
        if not isinstance(value, list | tuple) or not all(isinstance(one, str) for one in value):
            raise ValueError("expected a list of texts")
        if "\0" in "".join(value):
            raise ValueError(NO_NUL)
        value = tuple(value)
    else:
        value = _scalar(next((one for one in get_args(kind) if one is not type(None)), kind), value)
    if wrong := wrong_value(found[name], value):
        raise ValueError(wrong)
    return value


def _scalar(kind: type, value: Any) -> Any:
    accepted = {int: (int,), float: (int, float), bool: (bool,), str: (str,), Path: (str, Path)}[kind]
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        raise ValueError(f"expected {KINDS[kind]}")
    if isinstance(value, str) and "\0" in value:
        raise ValueError(NO_NUL)
    try:
        return kind(value)
    except OverflowError as error:  # a whole number that is too large for a float
        raise ValueError("expected a finite number") from error


def meant(word: str, known: Collection[str]) -> str:
    """Return the known word that is similar to `word`, or otherwise all known words."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f"{close[0]}" if close else one_of(sorted(known))


def checked_defaults(defaults: Any) -> TaskDefaults:
    """Return the checked defaults of a task, with values of the fields' types.

    Args:
        defaults: Preset -> stage -> field -> value; instead of a field there may be a learner or network, with a
            mapping of fields and values.

    Raises:
        ValueError: One line that names the entry and what was expected there.
    """

    def entries(values: Any, form: str, known: Collection[str], *place: str) -> Iterator[tuple[str, Any]]:
        if not isinstance(values, Mapping):
            raise _wrong(place, f"expected a mapping, {form}")
        for name, value in values.items():
            if name not in known:
                raise _wrong((*place, name), f"expected {meant(str(name), known)}")
            yield name, value

    return {
        preset: {
            stage: _checked_values(STAGES[stage], values, preset, stage)
            for stage, values in entries(stages, "stage -> field -> value", STAGES, preset)
        }
        for preset, stages in entries(defaults, "preset -> stage -> field -> value", PRESETS)
    }


def _checked_values(config_class: type[Config], values: Any, *place: str) -> dict[str, Any]:
    if not isinstance(values, Mapping):
        raise _wrong(place, "expected a mapping, field -> value")
    variants = next(
        (item.metadata["choices"] for item in dataclasses.fields(config_class) if item.name == config_class.VARIANT), ()
    )
    checked: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping) and name in variants and place[-1] not in variants:
            checked[name] = _checked_values(config_class, value, *place, name)
            continue
        try:
            checked[name] = checked_value(config_class, str(name), value)
        except ValueError as error:
            raise _wrong((*place, name), str(error)) from error
    return checked


def _wrong(place: Sequence[Any], complaint: str) -> ValueError:
    where = "".join(f"[{key!r}]" for key in place)
    return ValueError(f"{where}: {complaint}" if where else complaint)
