"""Output files of stages. A finished file is never replaced silently."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import (
    Artifact,
    ArtifactError,
    UsageError,
    checkpoint_path,
    content_of,
    read_artifact,
    recipe_difference,
    recipe_of,
    write_artifact,
)
from artifacts.usage import InUse
from stages.runtime.run import RunOptions, StageResult, full_config

LONGEST_NAME = 255  # bytes, on the usual file systems
MOST_NAMED = 4  # maximum number of differences that a message lists


@dataclass(frozen=True)
class Output:
    """The artifact that a stage is about to make.

    Attributes:
        path: Path of the artifact.
        kind: Kind of the artifact.
        recipe: Requested stage, configuration, seed and inputs (`artifacts.recipe_of`), stored in the artifact.
        run: Options of the run.
        found: Identity of the file at `path` before the work began; None: there was none.
        unset: Default of each field of the configuration, JSON values.
        inputs: Marks of the inputs, which `ifo gc` does not remove as long as the stage runs.
    """

    path: Path
    kind: str
    recipe: dict[str, Any]
    run: RunOptions
    found: tuple[int, int] | None
    unset: dict[str, Any]
    inputs: InUse = field(default_factory=InUse, compare=False, repr=False)

    @classmethod
    def of(
        cls,
        path: Path,
        kind: str,
        stage: str,
        config: Any,
        run: RunOptions,
        parents: Sequence[Path | Artifact] = (),
        extra: Mapping[str, Any] | None = None,
    ) -> Output:
        """Return the output of a stage with a given configuration.

        Args:
            path: Path of the artifact.
            kind: Kind of the artifact.
            stage: Name of the stage.
            config: The stage's configuration, a dataclass.
            run: Options of the run.
            parents: The artifacts that the stage reads.
            extra: Other values that determine the result, JSON values (the task, digests of other input files).

        Raises:
            ArtifactError: A parent cannot be read.
            UsageError: The path cannot be used.
        """
        check_name(path)
        recipe = recipe_of(stage, full_config(stage, config, run, **(extra or {})), run.seed, parents)
        unset = {item.name: item.default for item in dataclasses.fields(config)}
        defaults = recipe_of(stage, unset, run.seed)["config"]
        return cls(path, kind, recipe, run, _identity(path), defaults, _in_use(parents))

    def kept(self) -> StageResult | None:
        """Return the finished artifact if it is exactly what the stage would make; None if there is no file yet.

        With --overwrite the result is always None: the work is done again.

        Raises:
            UsageError: A different file exists, which would be replaced.
        """
        if self.run.overwrite or self.found is None:
            return None
        way_out = "choose another --out, or replace it with --overwrite"
        try:
            artifact = read_artifact(self.path)
        except ArtifactError as error:
            raise UsageError(f"{self.path} exists and is not a readable artifact ({error}): {way_out}") from error
        if artifact.kind != self.kind:
            raise UsageError(f"{self.path} exists and holds a {artifact.kind}, not a {self.kind}: {way_out}")
        other = [name for name in recipe_difference(artifact, self.recipe) if not self._is_new_option(artifact, name)]
        if other:
            named = ", ".join(other[:MOST_NAMED]) + (", ..." if len(other) > MOST_NAMED else "")
            raise UsageError(f"{self.path} exists and differs from what this command makes ({named}): {way_out}")
        self.run.progress.say(f"kept {self.path}: it is what this command makes (--overwrite makes it again)")
        return StageResult(self.path, dict(artifact.manifest.summary))

    def _is_new_option(self, artifact: Artifact, name: str) -> bool:
        """Whether an option did not exist yet when the artifact was made, and now has its default value."""
        asked = self.recipe["config"]
        return name in self.unset.keys() - artifact.manifest.recipe.get("config", {}).keys() and (
            asked[name] == self.unset[name]
        )

    def made_from(self, parents: Sequence[Path | Artifact]) -> Output:
        """Return the same output with other parents in its recipe."""
        contents = [parent.content if isinstance(parent, Artifact) else content_of(parent) for parent in parents]
        return dataclasses.replace(self, recipe={**self.recipe, "parents": contents}, inputs=_in_use(parents))

    def write(
        self,
        arrays: Mapping[str, np.ndarray],
        *,
        config: dict[str, Any],
        summary: Mapping[str, Any],
        parents: Sequence[Path | Artifact] = (),
        environment: Mapping[str, str] | None = None,
    ) -> StageResult:
        """Write the artifact.

        Args:
            arrays: Datasets of the artifact.
            config: The complete configuration, including values that the stage determined.
            summary: The stage's figures, which are printed again by a later run that keeps the file.
            parents: The artifacts that it was made from.
            environment: Versions and devices.

        Raises:
            UsageError: Another process has written the file in the meantime.
        """
        if not self.run.overwrite and _identity(self.path) != self.found:
            raise UsageError(
                f"{self.path} was written by another process in the meantime: choose another --out, or replace it "
                "with --overwrite"
            )
        write_artifact(
            self.path,
            self.kind,
            arrays,
            config=config,
            seed=self.run.seed,
            command=self.run.command,
            parents=parents,
            environment=environment,
            recipe=self.recipe,
            summary=dict(summary),
        )
        return StageResult(self.path, dict(summary))


def check_name(path: Path) -> None:
    """Refuse a path whose name is so long that the files beside it could not be written, before any work is done.

    Raises:
        UsageError: The name is too long.
    """
    if len(os.fsencode(checkpoint_path(path).name)) > LONGEST_NAME:
        raise UsageError(f"the file name of {path} is too long: choose a shorter one with --out")


def name_tags(config: Any, usual: Any, run: RunOptions, seed: int, preset: str) -> str:
    """Return the suffix of the default file name that distinguishes runs with different options.

    Args:
        config: The stage's configuration.
        usual: The default configuration for this preset and task.
        run: Options of the run.
        seed: The parent's seed, which the name does not mention.
        preset: The parent's preset, which the name does not mention.

    Returns:
        For example `-ppo-without-img-s1`: the values of the fields marked `tag` that differ from `usual`, and the
        preset and seed if they differ from the parent's.
    """
    tags = [] if run.preset == preset else [run.preset]
    for item in dataclasses.fields(config):
        label, value = item.metadata.get("tag"), getattr(config, item.name)
        if label is None or value == getattr(usual, item.name):
            continue
        words = value if isinstance(value, tuple) else ("" if value is True else value,)
        tags.append(label + "-".join(str(word).replace(",", "-") for word in words) if words else f"no-{item.name}")
    if run.seed != seed:
        tags.append(f"s{run.seed}")
    return "".join(f"-{tag}" for tag in tags)


def _in_use(parents: Sequence[Path | Artifact]) -> InUse:
    return InUse(parent.path if isinstance(parent, Artifact) else parent for parent in parents)


def _identity(path: Path) -> tuple[int, int] | None:
    """Return what distinguishes a file from one that replaces it; None: there is no file."""
    try:
        found = path.stat()  # Of the file that a link leads to, which is the one that is replaced.
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns
