"""What a command's options come to: the command line, a file of options, the parent, the preset, in that order."""

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
    """Options as the command will run with them.

    Attributes:
        config: The command's own configuration.
        settings: Those of `SETTINGS` that it has.
        given: Names of the options that somebody gave.
        origins: Who set each option.
        task: Name of the task; empty: none is known.
        task_known: Whether its own defaults are known; a task that a file names is not imported without leave.
    """

    config: Any
    settings: dict[str, Any]
    given: frozenset[str]
    origins: dict[str, str]
    task: str
    task_known: bool = True


def read_file(given: Given) -> Table:
    """What the file of --config says of the command.

    Raises:
        UsageError: It cannot be read, or says what the command does not take; or a value on the command line is wrong.
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
    """Refuse what can be refused before the input is there, for which whole stages may have to run.

    Raises:
        UsageError: The options make no sense under any preset.
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
    """Settle every option, and refuse what makes no sense together.

    Args:
        given: What the command line said.
        table: What the file of --config said.
        parents: The inputs.
        task: Name of the task.
        typed: Whether the task was named on the command line.

    Raises:
        UsageError: The options make no sense together, or the task cannot be made.
    """
    settings, origins = _settings(given, table, parents)
    own: Mapping[str, Any] = {}
    known = True
    if task and given.command in STAGES:
        from stages.simulation.registry import task_defaults

        # Stages that cannot do without the task's code say themselves that they may not import it.
        known = typed or is_trusted(task)
        own = task_defaults(task, typed) if known else {}
    base = _base(given.command, settings.get("preset", ""), task, _variant(given, table), own)
    file = str(given.get("config"))
    resolved = base.with_(file, table.config).with_("given", given.config)
    # A whole file, as --show-config prints it, asks for nothing where it says what would have been anyway.
    asked = {name for name, value in table.config.items() if value != getattr(base.config, name)}
    names = frozenset(asked - set(given.config)) | _named(given, settings)
    try:
        resolved.config.validate(names)
    except UsageError as error:
        if not table.config:
            raise
        raise UsageError(f"{error} (options come from {file}, too)") from error
    return Settled(resolved.config, settings, names, {**origins, **resolved.origins}, task, known)


def show(given: Given, settled: Settled) -> None:
    """Print every option, as a table of a file of options."""
    parts = [f"ifo {given.command}: what its options resolve to"]
    parts += [f"task {settled.task}"] if settled.task else []
    values = {**settled.settings, **vars(settled.config)}
    emit(as_toml(given.command, values, settled.origins, ", ".join(parts)))


def _base(command: str, preset: str, task: str, variant: str, own: Mapping[str, Any]) -> Resolved:
    if command in STAGES:
        return resolve(command, preset, task, variant, own)
    config = COMMANDS[command].config()
    return Resolved(config, dict.fromkeys(vars(config), "default"))


def _variant(given: Given, table: Table) -> str:
    """The learner or network that somebody chose; empty: nobody did."""
    name = COMMANDS[given.command].config.VARIANT
    return {**table.config, **given.config}.get(name, "")


def _named(given: Given, settings: Mapping[str, Any] | None = None) -> frozenset[str]:
    """Names of the options that were given; the CPU is what a stage without use for a device takes anyway."""
    device = (settings or given.shared).get("device", "auto")
    return frozenset(given.config) | (frozenset(("device",)) if device not in ("auto", "cpu") else frozenset())


def _settings(given: Given, table: Table, parents: Sequence[Artifact]) -> tuple[dict[str, Any], dict[str, str]]:
    """The options of the run, and who set each."""
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
    """Preset and seed of the first parent."""
    if not parents:
        return {}
    manifest = parents[0].manifest
    preset = manifest.config.get("preset")
    return {"seed": manifest.seed, **({"preset": preset} if preset in PRESETS else {})}
