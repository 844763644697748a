"""Migration of files with older schemas: one function per step, applied when a file is read.

Files on disk are never changed. To change a schema, increase its version in `KINDS`, write a step like this one, and
commit a file with the old schema under tests/fixtures/:

    @migration("demos", 2)
    def _name_the_lengths(manifest, arrays):
        manifest["config"].setdefault("horizon", 50)
        arrays.rename("distance", "final_distance")

Checkpoints store the configuration of their stage. When an option of a stage is added, renamed or removed, register a
step for the stage, so that older checkpoints can still be resumed. The step applies to checkpoints of the given schema
version:

    @configuration("learn-policy", 2)
    def _add_warmup(config):
        config.setdefault("warmup", 0)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from artifacts.errors import ArtifactError
from artifacts.kinds import KINDS
from artifacts.pipeline import COMMANDS, STAGE_FILES


@dataclass(frozen=True)
class Source:
    """Where an array comes from: a dataset in the file (with an optional transform), or memory."""

    stored: str | None
    transform: Callable[[np.ndarray], np.ndarray] | None = None
    value: np.ndarray | None = None


class ArrayView:
    """The names of an artifact's arrays and the source of each; data is read only on request."""

    def __init__(self, names: Iterable[str]) -> None:
        self.sources = {name: Source(name) for name in names}

    def rename(self, old: str, new: str) -> None:
        self.sources[new] = self.sources.pop(old)

    def drop(self, name: str) -> None:
        del self.sources[name]

    def add(self, name: str, value: np.ndarray) -> None:
        self.sources[name] = Source(None, value=np.asarray(value))

    def change(self, name: str, function: Callable[[np.ndarray], np.ndarray]) -> None:
        """Apply `function` to the whole array when it is read, after any earlier change."""
        source = self.sources[name]
        before = source.transform
        if source.value is not None:
            self.add(name, function(source.value))
        elif before is None:
            self.sources[name] = Source(source.stored, function)
        else:
            self.sources[name] = Source(source.stored, lambda array: function(before(array)))


Migration = Callable[[dict[str, Any], ArrayView], None]
MIGRATIONS: dict[tuple[str, int], Migration] = {}

Configuration = Callable[[dict[str, Any]], None]
CONFIGURATIONS: dict[tuple[str, int], Configuration] = {}


def migration(kind: str, from_version: int) -> Callable[[Migration], Migration]:
    """Register the migration of a kind from one schema version to the next."""

    def register(function: Migration) -> Migration:
        MIGRATIONS[kind, from_version] = function
        return function

    return register


def configuration(stage: str, from_version: int) -> Callable[[Configuration], Configuration]:
    """Register the migration of a stage's configuration from one schema version of checkpoints to the next."""

    def register(function: Configuration) -> Configuration:
        CONFIGURATIONS[stage, from_version] = function
        return function

    return register


def migrate(manifest: dict[str, Any], arrays: ArrayView) -> None:
    """Migrate manifest and arrays to the current schema, in place.

    Raises:
      ArtifactError: A step is missing, so the file is too old to be read.
    """
    kind = manifest["kind"]
    for version in range(manifest["schema_version"], KINDS[kind].version):
        step = MIGRATIONS.get((kind, version))
        if step is None:
            raise ArtifactError(
                f"is of {kind} schema {version}, which is no longer supported: "
                f"make it again with `{COMMANDS.get(kind, 'ifo')}`"
            )
        step(manifest, arrays)
        if kind == "checkpoint":
            _migrate_configuration(manifest["config"], version)
        manifest["schema_version"] = version + 1


def _migrate_configuration(config: Any, version: int) -> None:
    """Migrate the configuration in a checkpoint; anything else is refused when the manifest is checked."""
    stage = config.get("stage") if isinstance(config, dict) else None
    step = CONFIGURATIONS.get((stage, version)) if isinstance(stage, str) else None
    if step is not None:
        step(config)


def _without_digests(manifest: dict[str, Any], arrays: ArrayView) -> None:
    """No-op: schema 1 recorded the SHA-256 of parents' files; the missing digests, recipe and summary have defaults."""


for _kind in ("checkpoint", *(files.writes for files in STAGE_FILES.values())):
    migration(_kind, 1)(_without_digests)
