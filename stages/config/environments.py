"""Gymnasium environments as options name them, and permission for artifacts to name them. Light imports only."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

from artifacts.errors import UsageError

PREFIX = "env:"  # of an environment where a task is expected
TRUSTED = "IFO_ENVS"  # environment variable: comma-separated list of environments whose code artifacts may name


def parse_kwargs(words: Sequence[str]) -> dict[str, Any]:
    """Return the keyword arguments given by `--env-kwargs KEY=VALUE`; a value is JSON, or else text.

    Raises:
        UsageError: A word has no key, or a key occurs twice.
    """
    kwargs: dict[str, Any] = {}
    for word in words:
        key, equals, text = word.partition("=")
        if not equals or not key.isidentifier():
            raise UsageError(f"--env-kwargs {word}: expected KEY=VALUE, for example width=96")
        if key in kwargs:
            raise UsageError(f"--env-kwargs {word}: {key} is given twice")
        kwargs[key] = _value(text)
    return kwargs


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


def parse_viewpoint(text: str) -> tuple[float, float, float] | None:
    """Return azimuth, elevation and distance of `--viewpoint A,E,D`; None: it is empty.

    Raises:
        UsageError: The text is no viewpoint.
    """
    if not text:
        return None
    try:
        azimuth, elevation, distance = map(float, text.split(","))
    except ValueError:
        azimuth = elevation = distance = math.nan
    if not (abs(azimuth) <= 360 and abs(elevation) <= 90 and 0.01 <= distance <= 100):
        raise UsageError(f"--viewpoint {text}: expected AZIMUTH,ELEVATION,DISTANCE, for example 30,-10,1.2")
    return azimuth, elevation, distance


SUCCESS_HELP = (
    "Function MODULE:ATTR of the observation and `info` of the last step that returns whether the episode succeeds "
    "(default: what the environment reports)."
)


def check_success(name: str) -> None:
    """Refuse a `--success` that is no MODULE:ATTR.

    Raises:
        UsageError: It is not.
    """
    module, colon, attribute = name.partition(":")
    if name and not (module and colon and attribute.isidentifier()):
        raise UsageError(f"--success {name}: expected MODULE:ATTR, a function of the last observation and info")


def refuse_unless_trusted(name: str, kwargs: Mapping[str, Any]) -> None:
    """Refuse an environment of a file that would import code or open other files, unless the user permits it.

    Raises:
        UsageError: The name has a module, or an argument may be a path, and the user has not permitted it.
    """
    listed = {word.strip() for word in os.environ.get(TRUSTED, "").split(",")}
    if name in listed:
        return
    if ":" in name:
        raise UsageError(
            f"the file names {name!r}, whose code is imported only with your permission: if you trust it, export "
            f"{TRUSTED}={','.join(sorted({*filter(None, listed), name}))}"
        )
    paths = [key for key, value in kwargs.items() if not _is_plain(value)]
    if paths:
        raise UsageError(
            f"the file passes {paths[0]}={kwargs[paths[0]]!r} to environment {name!r}, which may open other files: if "
            f"you trust it, export {TRUSTED}={name}"
        )


def _is_plain(value: Any) -> bool:
    """Whether a value cannot be a path: a number, a boolean, a plain word, or a list or mapping of these."""
    if isinstance(value, list):
        return all(map(_is_plain, value))
    if isinstance(value, dict):
        return all(map(_is_plain, value.values()))
    return not isinstance(value, str) or value.replace("-", "_").isidentifier()


def permission_needed(name: str, kwargs: Mapping[str, Any], success: str) -> str:
    """Return what the user must do so that later stages can make the environment; empty: nothing."""
    needed = [other for other, given in ((name, kwargs), (success, {})) if other and not _is_trusted(other, given)]
    if not needed:
        return ""
    return f"later stages use {' and '.join(needed)} only with your permission: export {TRUSTED}={','.join(needed)}"


def _is_trusted(name: str, kwargs: Mapping[str, Any]) -> bool:
    try:
        refuse_unless_trusted(name, kwargs)
    except UsageError:
        return False
    return True
