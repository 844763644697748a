"""Checkpoints: the state that an interrupted stage needs to continue exactly, as a tree of plain values and arrays."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from artifacts.atomic import remove_abandoned
from artifacts.errors import ArtifactError
from artifacts.paths import sibling
from artifacts.schema import Manifest
from artifacts.store import Artifact, read_artifact
from artifacts.tree import pack, unpack
from artifacts.writing import write_artifact


def checkpoint_path(out: str | Path) -> Path:
    """`runs/x.policy.h5` gives `runs/x.policy.checkpoint.h5`."""
    return sibling(out, ".checkpoint.h5")


def write_checkpoint(
    path: str | Path,
    tree: Any,
    *,
    stage: str,
    config: dict[str, Any],
    seed: int,
    command: str,
    parents: Sequence[str | Path | Artifact] = (),
) -> Path:
    """Write a stage's state atomically.

    Args:
      path: Path of the checkpoint.
      tree: The state, a tree that `pack` accepts.
      stage: Name of the stage.
      config: The stage's complete configuration, JSON values.
      seed: Seed of the run.
      command: The command line.
      parents: The stage's input artifacts. Pass opened artifacts; otherwise each checkpoint opens them again.
    """
    text, arrays = pack({"stage": stage, "state": tree})
    datasets = {f"arrays/{name}": array for name, array in arrays.items()}
    datasets["tree"] = np.frombuffer(text.encode("ascii"), np.uint8)
    return write_artifact(path, "checkpoint", datasets, config=config, seed=seed, command=command, parents=parents)


def read_checkpoint(path: str | Path, *, stage: str) -> tuple[Manifest, Any]:
    """Return the manifest and the tree that a stage wrote.

    The configuration in the manifest is migrated: options that are newer than the checkpoint have been added
    (`artifacts.migrations.configuration`).

    Raises:
      ArtifactError: The file does not exist, is damaged, or was written by another stage.
    """
    artifact = read_artifact(path, "checkpoint")
    if "tree" not in artifact:
        raise ArtifactError(f"{path} holds no state: start the stage again without --resume")
    try:
        content = unpack(artifact["tree"].tobytes().decode("ascii"), artifact.group("arrays"))
        found, tree = content["stage"], content["state"]
    except (ArtifactError, UnicodeError, KeyError, TypeError) as error:
        if isinstance(error, ArtifactError) and str(path) in str(error):
            raise
        raise ArtifactError(
            f"{path} is not a readable checkpoint ({error}): start the stage again without --resume"
        ) from error
    if found != stage:
        raise ArtifactError(
            f"{path} is a checkpoint of {str(found)[:100]}, expected one of {stage}: start again without --resume"
        )
    return artifact.manifest, tree


def remove_checkpoint(out: str | Path) -> None:
    """Remove the checkpoint that belongs to an artifact, if there is one, and what killed writers of it left behind."""
    path = checkpoint_path(out)
    path.unlink(missing_ok=True)
    remove_abandoned(path)
