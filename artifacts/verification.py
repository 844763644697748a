"""Check artifacts: is their data undamaged, and are their parents the ones that they were made from?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from artifacts import hdf5
from artifacts.errors import ArtifactError
from artifacts.store import check_parent, open_unchanged, read_artifact
from artifacts.wording import undamaged


@dataclass(frozen=True)
class VerifyReport:
    """What `verify_artifact` found in order: `bytes` is the file's size."""

    path: Path
    kind: str
    datasets: int
    bytes: int
    parents: int


def verify_artifact(path: str | Path) -> VerifyReport:
    """Read every dataset, piece by piece, check its digest, and check that each parent is there and is the same.

    A parent is compared by its manifest; its own data is checked when it is verified itself.

    Raises:
      ArtifactError: the first problem, in one line.
    """
    artifact = read_artifact(path)
    digests = artifact.manifest.datasets
    with open_unchanged(artifact) as file:
        names = hdf5.dataset_names(file)
        for name in names:
            with undamaged(f"dataset {name} is damaged"):
                dataset = file[name]
                if dataset.size and not dataset.fletcher32:
                    raise ArtifactError(f"dataset {name} has no checksum: ifo did not write it like this")
                if hdf5.dataset_digest(dataset) != digests.get(name) and digests:
                    raise OSError(hdf5.WRONG_DIGEST)
    for parent in artifact.manifest.parents:
        check_parent(artifact.path, parent)
    size = artifact.path.stat().st_size
    return VerifyReport(artifact.path, artifact.kind, len(names), size, len(artifact.manifest.parents))
