"""Resolve a command's options from, in order of priority, the command line, --config, the parent and the preset."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from artifacts.errors import UsageError
from ifo_cli.options import Given
from ifo_cli.streams import emit
from stages.config.commands import COMMANDS
from stages.config.common import SETTINGS, check_device
from stages.config.fields import shown, wrong_value
from stages.config.presets import PRESETS, Resolved, resolve
from stages.config.stages import STAGES
from stages.config.task_names import is_trusted
from stages.config.toml import Table, as_toml, read_table

if TYPE_CHECKING:
    from artifacts import Artifact


@dataclass(frozen=True)
class Settled:
    """The resolved options of a command.

    Attributes:
        config: The command's own configuration.
        settings: The options in `SETTINGS` that the command has.
        given: Names of the options that the user gave.
        origins: Origin of each option's value.
        task: Name of the task; empty: unknown.
        task_known: Whether the task's own defaults are known. Importing a task that a file names needs permission.
    """

    config: Any
    settings: dict[str, Any]
    given: frozenset[str]
    origins: dict[str, str]
    task: str
    task_known: bool = True


def read_file(given: Given) -> Table:
    """Read the command's table in the file that --config names, and check the values on the command line.

    Raises:
        UsageError: The file cannot be read or has options that the command does not have, or a value on the command
            line is invalid.
    """
    command = COMMANDS[given.command]
    for config_class, values in ((command.config, given.config), (command.shared, given.shared)):
        for item in dataclasses.fields(config_class):
            if item.name in values and (wrong := wrong_value(item, values[item.name])):
                raise UsageError(f"{shown(item.name, values[item.name])}: {wrong}")
    path = given.get("config") if "config" in command.names else None
    table = read_table(path, given.command) if path else Table({}, {})
    if device := given.shared.get("device") or table.settings.get("device"):
        check_device(device)
    return table


def check_at_once(given: Given, table: Table) -> None:
    """Refuse options as early as possible, before the input is read: earlier stages in a pipe may take hours.

    Raises:
        UsageError: The options are invalid under every preset.
    """
    complaints = []
    for preset in PRESETS:
        base = _base(given.command, preset, "", _variant(given, table), {})
        try:
            base.with_("", {**table.config, **given.config}).config.validate(_named(given))
        except UsageError as error:
            complaints.append(error)
        else:
            return
    raise complaints[-1]


def settle(
    given: Given, table: Table, parents: Sequence[Artifact] = (), task: str = "", typed: bool = False
) -> Settled:
    """Resolve every option, and refuse invalid combinations.

    Args:
        given: The parsed command line.
        table: The command's table in the file that --config names.
        parents: The input artifacts.
        task: Name of the task.
        typed: Whether the task was named on the command line.

    Raises:
        UsageError: The combination of options is invalid, or the task cannot be made.
    """
    settings, origins = _settings(given, table, parents)
    own: Mapping[str, Any] = {}
    known = True
    if task and given.command in STAGES:
        from stages.simulation.registry import task_defaults

        # Stages that need the task's code report themselves that they may not import it.
        known = typed or is_trusted(task)
        own = task_defaults(task, typed) if known else {}
    base = _base(given.command, settings.get("preset", ""), task, _variant(given, table), own)
    file = str(given.get("config"))
    resolved = base.with_(file, table.config).with_("given", given.config)
    # A file printed by --show-config holds every option: only those that differ from the defaults count as given.
    asked = {name for name, value in table.config.items() if value != getattr(base.config, name)}
    names = frozenset(asked - set(given.config)) | _named(given, settings)
    try:
        resolved.config.validate(names)
    except UsageError as error:
        if not table.config:
            raise
        raise UsageError(f"{error} (some options come from {file})") from error
    return Settled(resolved.config, settings, names, {**origins, **resolved.origins}, task, known)


def show(given: Given, settled: Settled) -> None:
    """Print every option as a table of a file of options."""
    parts = [f"ifo {given.command}: resolved options"]
    parts += [f"task {settled.task}"] if settled.task else []
    values = {**settled.settings, **vars(settled.config)}
    emit(as_toml(given.command, values, settled.origins, ", ".join(parts)))


def _base(command: str, preset: str, task: str, variant: str, own: Mapping[str, Any]) -> Resolved:
    if command in STAGES:
        return resolve(command, preset, task, variant, own)
    config = COMMANDS[command].config()
    return Resolved(config, dict.fromkeys(vars(config), "default"))


def _variant(given: Given, table: Table) -> str:
    """Return the learner or network that the user chose; empty: none."""
    name = COMMANDS[given.command].config.VARIANT
    return {**table.config, **given.config}.get(name, "")


def _named(given: Given, settings: Mapping[str, Any] | None = None) -> frozenset[str]:
    """Return the names of the options that were given; `auto` and `cpu` do not count as a given device."""
    device = (settings or given.shared).get("device", "auto")
    return frozenset(given.config) | (frozenset(("device",)) if device not in ("auto", "cpu") else frozenset())


def _settings(given: Given, table: Table, parents: Sequence[Artifact]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the options of the run and the origin of each."""
    settings: dict[str, Any] = {}
    origins: dict[str, str] = {}
    layers: list[tuple[str, Mapping[str, Any]]] = [
        ("default", vars(COMMANDS[given.command].shared())),
        ("parent", _inherited(parents)),
        (str(given.get("config")), table.settings),
        ("given", given.shared),
    ]
    for origin, values in layers:
        for name in SETTINGS:
            if name in COMMANDS[given.command].names and name in values:
                settings[name], origins[name] = values[name], origin
    return settings, origins


def _inherited(parents: Sequence[Artifact]) -> dict[str, Any]:
    """Return the preset and seed of the first parent."""
    if not parents:
        return {}
    manifest = parents[0].manifest
    preset = manifest.config.get("preset")
    return {"seed": manifest.seed, **({"preset": preset} if preset in PRESETS else {})}
