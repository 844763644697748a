"""Writing of artifacts."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import hdf5
from artifacts.atomic import atomic_path
from artifacts.content import content_digest
from artifacts.errors import ArtifactError
from artifacts.kinds import KINDS, is_finite
from artifacts.paths import real
from artifacts.schema import Manifest, Parent, json_values
from artifacts.store import Artifact, read_artifact
from artifacts.version import ifo_version
from artifacts.wording import naming


def write_artifact(
    path: str | Path,
    kind: str,
    arrays: Mapping[str, np.ndarray],
    *,
    config: Mapping[str, Any],
    seed: int,
    command: str,
    parents: Sequence[str | Path | Artifact] = (),
    environment: Mapping[str, str] | None = None,
    recipe: Mapping[str, Any] | None = None,
    summary: Mapping[str, Any] | None = None,
) -> Path:
    """Write an artifact atomically; an older file of that name is replaced.

    Args:
      path: Path of the artifact, by convention `NAME.KIND.h5`; the folder is created if it is missing.
      kind: One of `KINDS`.
      arrays: Dataset name (slashes make groups) -> array of numbers, booleans or strings.
      config: The stage's complete configuration, JSON values.
      seed: Seed of the run.
      command: The command line, such that the user can repeat it.
      parents: The artifacts that this one was made from. For an opened `Artifact` the content at the time of opening is
        recorded, for a path the current content.
      environment: Versions and devices.
      recipe: The requested stage, configuration, seed and inputs, from `recipe_of`.
      summary: Figures that are printed again when the artifact is kept; JSON values, not part of the content.

    Raises:
      ArtifactError: The arrays do not match the kind, or a parent is unreadable. Nothing is written.
      PlatformError: The file cannot be written.
    """
    path = Path(path)
    arrays = {name: np.asarray(array) for name, array in arrays.items()}
    if kind not in KINDS:
        raise ArtifactError(f"{path}: {kind!r} is not a kind of artifact: expected one of {', '.join(KINDS)}")
    with naming(path):
        hdf5.check_arrays(arrays)
        problem = KINDS[kind].problem({name: (array.shape, array.dtype) for name, array in arrays.items()})
        if problem:
            raise ArtifactError(problem)
        for name, array in arrays.items():
            if KINDS[kind].must_be_finite(name) and not is_finite(array):
                raise ArtifactError(f"dataset {name} would hold values that are NaN or infinite: not written")
    version, values = KINDS[kind].version, json_values(config)
    recorded = [_recorded(parent, path) for parent in parents]
    digests = {name: hdf5.digest_of(array) for name, array in arrays.items()}
    manifest = Manifest(
        kind=kind,
        schema_version=version,
        created=_now(),
        ifo_version=ifo_version(),
        config=values,
        seed=int(seed),
        command=command,
        parents=recorded,
        environment={name: str(value) for name, value in (environment or {}).items()},
        datasets=digests,
        content=content_digest(kind, version, digests, values, int(seed), [parent.digest for parent in recorded]),
        recipe=json_values(recipe or {}),
        summary=json_values(summary or {}),
    )
    attributes = manifest.to_attributes()
    room = hdf5.room_for(arrays, attributes)
    with atomic_path(path) as temporary, hdf5.new_file(temporary, room) as file:
        hdf5.write_attributes(file, attributes)
        for name, array in arrays.items():
            hdf5.write_dataset(file, name, array)
    return path


def _recorded(parent: str | Path | Artifact, child: Path) -> Parent:
    """Return the record of a parent for its child's manifest."""
    artifact = parent if isinstance(parent, Artifact) else read_artifact(parent)
    out, target = real(child), real(artifact.path)
    if target == out:
        raise ArtifactError(f"{child}: would replace its own input: choose another --out")
    relative = Path(os.path.relpath(target, out.parent)).as_posix()
    return Parent(kind=artifact.kind, path=relative, content=artifact.content)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
