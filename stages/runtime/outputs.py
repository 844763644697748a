"""Where a stage writes, and what happens if a file is there already: nothing finished is replaced silently."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import (
    Artifact,
    ArtifactError,
    UsageError,
    content_of,
    read_artifact,
    recipe_difference,
    recipe_of,
    write_artifact,
)
from stages.runtime.run import RunOptions, StageResult, full_config

MOST_NAMED = 4  # differences that a message lists


@dataclass(frozen=True)
class Output:
    """The artifact that a stage is about to make.

    Attributes:
        path: Where it goes.
        kind: Its kind.
        recipe: What the command asks for (`artifacts.recipe_of`), kept in the artifact.
        run: How the stage runs.
        found: Identity of the file that `path` named before the work began; None: there was none.
    """

    path: Path
    kind: str
    recipe: dict[str, Any]
    run: RunOptions
    found: tuple[int, int] | None

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
        """The output of a stage with this configuration.

        Args:
            path: Where the artifact goes.
            kind: Its kind.
            stage: Name of the stage.
            config: The stage's configuration, a dataclass.
            run: How the stage runs.
            parents: The artifacts that the stage reads.
            extra: Whatever else decides the result, JSON values (the task, digests of other input files).

        Raises:
            ArtifactError: A parent cannot be read.
        """
        recipe = recipe_of(stage, full_config(stage, config, run, **(extra or {})), run.seed, parents)
        return cls(path, kind, recipe, run, _identity(path))

    def kept(self) -> StageResult | None:
        """The finished artifact where it is exactly what the stage would make; None where there is nothing yet.

        With --overwrite the answer is always None: the work is done again.

        Raises:
            UsageError: Another file is there, which would be replaced.
        """
        if self.run.overwrite or self.found is None:
            return None
        way_out = "choose another --out, or replace it with --overwrite"
        try:
            artifact = read_artifact(self.path)
        except ArtifactError as error:
            raise UsageError(f"{self.path} exists and is no readable artifact ({error}): {way_out}") from error
        if artifact.kind != self.kind:
            raise UsageError(f"{self.path} exists and holds a {artifact.kind}, not a {self.kind}: {way_out}")
        other = recipe_difference(artifact, self.recipe)
        if other:
            named = ", ".join(other[:MOST_NAMED]) + (", ..." if len(other) > MOST_NAMED else "")
            raise UsageError(f"{self.path} exists and differs from what this command makes ({named}): {way_out}")
        self.run.progress.say(f"kept {self.path}: it is what this command makes (--overwrite makes it again)")
        return StageResult(self.path, dict(artifact.manifest.summary))

    def made_from(self, parents: Sequence[Path | Artifact]) -> Output:
        """The same output, of these parents."""
        contents = [parent.content if isinstance(parent, Artifact) else content_of(parent) for parent in parents]
        return dataclasses.replace(self, recipe={**self.recipe, "parents": contents})

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
            arrays: Its datasets.
            config: The whole configuration, with what the stage found out on the way.
            summary: The stage's figures, which a later run that keeps the file prints again.
            parents: The artifacts that it was made from.
            environment: Versions and devices.

        Raises:
            UsageError: Another process has put a file there in the meantime.
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


def name_tags(config: Any, usual: Any, run: RunOptions, seed: int, preset: str) -> str:
    """What the default file name gets behind its stem, so that runs that differ do not share a name.

    Args:
        config: The stage's configuration.
        usual: What it is by default under this preset for this task.
        run: How the stage runs.
        seed: The seed that is not mentioned: the parent's.
        preset: The preset that is not mentioned: the parent's.

    Returns:
        For example `-ppo-without-img-s1`: the values of fields marked `tag` that differ from `usual`, a preset and a
        seed of the run's own.
    """
    tags = [] if run.preset == preset else [run.preset]
    for item in dataclasses.fields(config):
        label, value = item.metadata.get("tag"), getattr(config, item.name)
        if label is None or value == getattr(usual, item.name):
            continue
        words = value if isinstance(value, tuple) else (value,)
        tags.append(label + "-".join(str(word).replace(",", "-") for word in words) if words else f"no-{item.name}")
    if run.seed != seed:
        tags.append(f"s{run.seed}")
    return "".join(f"-{tag}" for tag in tags)


def _identity(path: Path) -> tuple[int, int] | None:
    """What tells a file from one that replaces it; None: there is none."""
    try:
        found = path.lstat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns
