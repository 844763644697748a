"""Write artifacts."""

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
from artifacts.schema import KINDS, Manifest, Parent, json_values
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
    """Write an artifact whole or not at all, replacing an older one of that name.

    Args:
      path: by convention `NAME.KIND.h5`; the folder is made if missing.
      kind: one of `KINDS`.
      arrays: dataset name (slashes make groups) -> array of numbers, booleans or strings.
      config: the stage's whole configuration, JSON values.
      seed: the run's seed.
      command: the command line as the user could repeat it.
      parents: the artifacts that this one was made from. An `Artifact` that was opened earlier is recorded as what
        it was then; a path as what is there now.
      environment: versions and devices.
      recipe: what the command asked for, from `recipe_of`.
      summary: figures to print again when the artifact is kept; JSON values, no part of the content.

    Raises:
      ArtifactError: the arrays are not what the kind holds, or a parent is unreadable. Nothing is written.
      PlatformError: the file cannot be written.
    """
    path = Path(path)
    arrays = {name: np.asarray(array) for name, array in arrays.items()}
    if kind not in KINDS:
        raise ArtifactError(f"{path}: {kind!r} is no kind of artifact: expected one of {', '.join(KINDS)}")
    with naming(path):
        hdf5.check_arrays(arrays)
        problem = KINDS[kind].problem({name: (array.shape, array.dtype) for name, array in arrays.items()})
        if problem:
            raise ArtifactError(problem)
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
    """What a child records of a parent."""
    artifact = parent if isinstance(parent, Artifact) else read_artifact(parent)
    folder, target = child.parent.resolve(), artifact.path.resolve()
    if target == child.resolve():
        raise ArtifactError(f"{child}: would replace its own input: choose another --out")
    relative = Path(os.path.relpath(target, folder)).as_posix()
    return Parent(kind=artifact.kind, path=relative, content=artifact.content)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
