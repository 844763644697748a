"""Files of options, with a table for each stage: --show-config prints them, --config reads them."""

from __future__ import annotations

import json
import os
import stat
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from artifacts.errors import UsageError
from stages.config.commands import COMMANDS
from stages.config.common import SETTINGS
from stages.config.fields import MOST
from stages.config.values import checked_value, meant
from stages.runtime.terminal import one_line

MOST_BYTES = 1 << 16
LONGEST_LINE = 1 << 12  # bytes: the parser needs quadratic time for a key of many parts
STAGES_WITH_TABLES = tuple(name for name, command in COMMANDS.items() if "config" in command.names)


@dataclass(frozen=True)
class Table:
    """The options of one stage in a file of options.

    Attributes:
        settings: Options of the run: preset, seed, device, workers.
        config: Options of the stage itself.
    """

    settings: dict[str, Any]
    config: dict[str, Any]


def read_table(path: Path, stage: str) -> Table:
    """Read the table of `stage` from a file of options; empty if there is none. Tables of other stages are ignored.

    Raises:
        UsageError: The file cannot be read, or has invalid options for the stage.
    """
    tables = _load(path)
    for name, table in tables.items():
        if not isinstance(table, Mapping):
            raise UsageError(f"{path}: {name}: expected a table named after a stage, for example [{stage}]")
        if name not in STAGES_WITH_TABLES:
            stages = meant(name, STAGES_WITH_TABLES)
            raise UsageError(f"{path}: [{name}]: expected a table named after a stage, {stages}")
    command = COMMANDS[stage]
    settings: dict[str, Any] = {}
    config: dict[str, Any] = {}
    for name, value in tables.get(stage, {}).items():
        shared = name in SETTINGS and name in command.names
        try:
            taken = checked_value(command.shared if shared else command.config, name, value)
        except ValueError as error:
            raise UsageError(f"{path}: [{stage}] {name} = {_text(value)}: {error}") from error
        (settings if shared else config)[name] = taken
    return Table(settings, config)


def _load(path: Path) -> dict[str, Any]:
    try:
        with open(path, "rb", opener=_open_without_waiting) as file:
            data = file.read(MOST_BYTES + 1)
            regular = stat.S_ISREG(os.fstat(file.fileno()).st_mode)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UsageError(f"--config {path}: cannot be read ({reason}): expected a file of options") from error
    if len(data) > MOST_BYTES or max(map(len, data.split(b"\n"))) > LONGEST_LINE:
        raise UsageError(
            f"--config {path}: is too large for a file of options: expected at most {MOST_BYTES >> 10} KiB, and "
            f"{LONGEST_LINE} bytes in a line"
        )
    if not data and not regular:
        raise UsageError(f"--config {path}: is an empty pipe or device: expected a file of options")
    try:
        return tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, numbers of too many digits, deep nesting
        reason = " ".join(str(error).split())
        raise UsageError(f"--config {path}: is not TOML ({reason}): expected the format of --show-config") from error


def _open_without_waiting(path: str, flags: int) -> int:
    """Open a file. A named pipe that nobody writes to is empty, instead of being waited for."""
    descriptor = os.open(path, flags | os.O_NONBLOCK)
    os.set_blocking(descriptor, True)
    return descriptor


def as_toml(stage: str, values: Mapping[str, Any], origins: Mapping[str, str], note: str) -> str:
    """Return a table of options, with the origin of each value as a comment.

    The text is formatted here because tomllib cannot write TOML.

    Args:
        stage: Name of the table.
        values: The options; those that are None are left out.
        origins: Origin of each option's value.
        note: Text of the first line, a comment.
    """
    rows = [
        (f"{name} = {_text(value)}", one_line(origins[name])) for name, value in values.items() if value is not None
    ]
    width = max(len(assignment) for assignment, _ in rows)
    return "\n".join([f"# {one_line(note)}", f"[{stage}]", *(f"{row:{width}}  # {origin}" for row, origin in rows)])


def _text(value: Any) -> str:
    """Return a value in TOML syntax."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, int) and abs(value) > MOST:
        return hex(value)  # Python writes no decimal number of more than 4300 digits.
    if isinstance(value, int | float):
        return repr(value)
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007F")
