"""Older schemas made readable: one function a step, applied when a file is read.

Write a new step like this, and commit a file of the old schema under tests/fixtures/:

    @migration("demos", 1)
    def _name_the_lengths(manifest, arrays):
        manifest["config"].setdefault("horizon", 50)
        arrays.rename("distance", "final_distance")

Files on disk are never changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from artifacts.errors import ArtifactError
from artifacts.schema import COMMANDS, KINDS


@dataclass(frozen=True)
class Source:
    """Where an array comes from: a dataset of the file (and what is done to it), or memory."""

    stored: str | None
    transform: Callable[[np.ndarray], np.ndarray] | None = None
    value: np.ndarray | None = None


class ArrayView:
    """The names of an artifact's arrays and where each comes from; nothing is read until asked for."""

    def __init__(self, names: Iterable[str]) -> None:
        self.sources = {name: Source(name) for name in names}

    def rename(self, old: str, new: str) -> None:
        self.sources[new] = self.sources.pop(old)

    def drop(self, name: str) -> None:
        del self.sources[name]

    def add(self, name: str, value: np.ndarray) -> None:
        self.sources[name] = Source(None, value=np.asarray(value))

    def change(self, name: str, function: Callable[[np.ndarray], np.ndarray]) -> None:
        """Put the whole array through `function` when it is read."""
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


def migration(kind: str, from_version: int) -> Callable[[Migration], Migration]:
    """Register the step from one schema version to the next."""

    def register(function: Migration) -> Migration:
        MIGRATIONS[kind, from_version] = function
        return function

    return register


def migrate(manifest: dict[str, Any], arrays: ArrayView) -> None:
    """Bring manifest and arrays to the current schema, in place."""
    kind = manifest["kind"]
    for version in range(manifest["schema_version"], KINDS[kind].version):
        step = MIGRATIONS.get((kind, version))
        if step is None:
            raise ArtifactError(
                f"is of {kind} schema {version}, which is no longer read: "
                f"make it again with `{COMMANDS.get(kind, 'ifo')}`"
            )
        step(manifest, arrays)
        manifest["schema_version"] = version + 1
