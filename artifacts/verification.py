"""Verification of artifacts: that their data is undamaged and their parents are unchanged."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from artifacts import hdf5
from artifacts.kinds import KINDS
from artifacts.layout import checked_names
from artifacts.paths import parent_path
from artifacts.store import Artifact, check_finite, checked_parent, open_unchanged, read_artifact
from artifacts.wording import undamaged


@dataclass(frozen=True)
class VerifyReport:
    """The file that `verify_artifact` found intact: path, kind, dataset count, size in bytes, parent count."""

    path: Path
    kind: str
    datasets: int
    bytes: int
    parents: int


def verify_artifact(path: str | Path) -> VerifyReport:
    """Read every dataset in blocks, check its digest, and check that each parent exists and is unchanged.

    Parents are compared by their manifests; a parent's data is checked only when the parent itself is verified.

    Raises:
      ArtifactError: The first problem, in one line.
    """
    artifact = read_artifact(path)
    names = check_data(artifact)
    parents = artifact.manifest.parents
    for parent in {(parent_path(artifact.path, parent), parent.digest): parent for parent in parents}.values():
        checked_parent(artifact.path, parent)
    size = artifact.path.stat().st_size
    return VerifyReport(artifact.path, artifact.kind, len(names), size, len(parents))


def check_data(artifact: Artifact) -> list[str]:
    """Read every dataset of an artifact in blocks, check its digest, and return the names of the datasets.

    Raises:
      ArtifactError: The first problem, in one line.
    """
    digests = artifact.manifest.datasets
    with open_unchanged(artifact) as file:
        names = checked_names(file)
        for name in names:
            with undamaged(f"dataset {name} is damaged"):
                must_be_finite = KINDS[artifact.kind].must_be_finite(name)
                digest = hdf5.dataset_digest(file[name], partial(check_finite, name) if must_be_finite else None)
                if digest != digests.get(name) and digests:
                    raise OSError(hdf5.WRONG_DIGEST)
    return names
