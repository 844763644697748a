"""A look at an artifact that costs little however large it is: its manifest, and the shapes of a few datasets."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from artifacts import hdf5
from artifacts.errors import ArtifactError
from artifacts.kinds import KINDS
from artifacts.schema import Manifest
from artifacts.store import check_is_file, checked_fields, read_artifact
from artifacts.wording import naming, undamaged

Identity = tuple[int, int, int, int]  # of a file: device, inode, size in bytes, modification time in nanoseconds


@dataclass(frozen=True)
class Glance:
    """What can be said of an artifact without reading its data, which may therefore be damaged.

    Attributes:
      path: The file.
      manifest: Its manifest.
      shapes: Shape of each of the datasets asked for that the file holds.
      identity: What distinguishes the file from one that replaces it.
    """

    path: Path
    manifest: Manifest
    shapes: dict[str, tuple[int, ...]]
    identity: Identity

    @property
    def kind(self) -> str:
        return self.manifest.kind

    @property
    def bytes(self) -> int:
        return self.identity[2]

    @property
    def modified(self) -> float:
        """Time of the last change of the file, in seconds since 1970."""
        return self.identity[3] / 1e9


def glance(path: str | Path, shapes: Sequence[str] = ()) -> Glance:
    """Read the manifest of an artifact, and the shapes of the datasets named in `shapes`.

    `read_artifact` also checks that every dataset is stored completely, which takes ten times as long.

    Raises:
      ArtifactError: One line that says what is wrong with the file.
    """
    path = Path(path)
    check_is_file(path)
    identity = identity_of(path)
    with naming(path), undamaged("is truncated or damaged"), hdf5.open_file(path) as file:
        fields = checked_fields(file)
        spec = KINDS[fields["kind"]]
        if fields["schema_version"] == spec.version:
            manifest = Manifest.from_fields(fields)
            spec.check_config(manifest.config)
            found = {name: shape for name in shapes if (shape := _shape(file, name)) is not None}
            return Glance(path, manifest, found, identity)
    artifact = read_artifact(path)  # Migrations need the names of all datasets.
    described = artifact.describe() if shapes else {}
    return Glance(path, artifact.manifest, {name: described[name][0] for name in shapes if name in described}, identity)


def identity_of(path: str | Path) -> Identity:
    """Return what distinguishes a file from one that replaces it; links are followed.

    Raises:
      ArtifactError: The file is gone.
    """
    try:
        status = os.stat(path)
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _shape(file: Any, name: str) -> tuple[int, ...] | None:
    """Return the shape of a dataset that is stored in the file itself; None: there is no such dataset."""
    import h5py

    # A link to another file is not followed, and the shape of a virtual dataset may depend on other files.
    if name not in file or file.id.links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
        return None
    found = file[name]
    if not isinstance(found, h5py.Dataset) or found.id.get_create_plist().get_layout() == h5py.h5d.VIRTUAL:
        return None
    return None if found.shape is None else tuple(map(int, found.shape))
