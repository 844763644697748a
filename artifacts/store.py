"""Reading of artifacts."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import hdf5
from artifacts.content import content_digest
from artifacts.errors import ArtifactError
from artifacts.kinds import DIGESTS_SINCE, KINDS, is_finite
from artifacts.layout import checked_names
from artifacts.migrations import ArrayView, Source, migrate
from artifacts.paths import check_regular, is_missing, parent_path, sha256_of
from artifacts.pipeline import COMMANDS
from artifacts.schema import DIGEST, Config, Manifest, Parent, attributes_digest, decode_attributes
from artifacts.wording import a_, either, how_to_make, naming, undamaged

REPLACED = "was replaced or removed while in use: run the command again"
LONGEST_KIND = 100
Kinds = str | tuple[str, ...] | None
Identity = tuple[int, int, int, int]  # identity of a file: device, inode, size, modification time


class Artifact:
    """An artifact on disk. The file is open only during a read.

    Every read raises ArtifactError, which names the file and the dataset, if the data is damaged or the file was
    replaced since `read_artifact`. Whole datasets are checked against their digests, parts of datasets only against
    HDF5's checksums.
    """

    def __init__(self, path: Path, manifest: Manifest, sources: dict[str, Source], identity: Identity | None) -> None:
        self.path = path
        self.manifest = manifest
        self._sources = sources
        self._identity = identity

    @property
    def kind(self) -> str:
        return self.manifest.kind

    @property
    def config(self) -> dict[str, Any]:
        """The stage's configuration; a missing key raises an ArtifactError that names the file."""
        return Config(self.path, self.manifest.config)

    @property
    def content(self) -> str:
        """Digest of the content: equal for two runs of the same command with the same seed.

        It is stored in the manifest. For a file of schema 1 it is computed once, by reading the whole file.
        """
        return self.manifest.content or _content_of_old(self.path, self._identity)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.read(name)

    def __contains__(self, name: object) -> bool:
        return name in self._sources

    def __repr__(self) -> str:
        return f"<Artifact {self.path} ({self.kind}, {len(self._sources)} datasets)>"

    def names(self, prefix: str = "") -> list[str]:
        """Return the names of the datasets that start with `prefix`, sorted."""
        return sorted(name for name in self._sources if name.startswith(prefix))

    def describe(self) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
        """Return the shape and type of every dataset, without reading the data."""
        with open_unchanged(self) as file:
            return {name: self._describe(file, name) for name in self.names()}

    def read(self, name: str, selection: Any = ...) -> np.ndarray:
        """Read a dataset, or the part given by a NumPy-style selection (`slice(3)`, `(0, ...)`)."""
        with open_unchanged(self) as file:
            return self._read(file, name, selection)

    def group(self, prefix: str) -> dict[str, np.ndarray]:
        """Read all datasets in a group: names relative to the group -> arrays; empty if there are none."""
        prefix = prefix.rstrip("/") + "/"
        with open_unchanged(self) as file:
            return {name.removeprefix(prefix): self._read(file, name) for name in self.names(prefix)}

    def parent(self, kind: str, *, check: bool = False) -> Artifact:
        """Open the parent of a kind; with `check`, verify that its content is unchanged."""
        for parent in self.manifest.parents:
            if parent.kind == kind:
                if check:
                    return checked_parent(self.path, parent, kind)
                return read_artifact(_existing_parent(self.path, parent), kind)
        raise ArtifactError(f"{self.path} has no {kind} among its parents: {how_to_make(kind)}")

    def _read(self, file: Any, name: str, selection: Any = ...) -> np.ndarray:
        if name not in self._sources:
            raise ArtifactError(f"has no dataset {name}: expected one of {', '.join(self.names()) or 'none'}")
        array = self._stored(file, self._sources[name], selection)
        if KINDS[self.kind].must_be_finite(name):
            check_finite(name, array)
        return array

    def _stored(self, file: Any, source: Source, selection: Any) -> np.ndarray:
        if source.stored is None:
            return np.array(np.asarray(source.value)[selection])
        digest = self.manifest.datasets.get(source.stored)
        with undamaged(f"dataset {source.stored} is damaged"):
            if source.transform is None:
                return hdf5.read_dataset(file[source.stored], selection, digest)
            whole = hdf5.read_dataset(file[source.stored], digest=digest)
        return np.asarray(source.transform(whole)[selection])

    def _describe(self, file: Any, name: str) -> tuple[tuple[int, ...], np.dtype]:
        source = self._sources[name]
        if source.stored is not None and source.transform is None:
            return hdf5.describe(file[source.stored])
        array = self._read(file, name)
        return array.shape, array.dtype


def read_artifact(path: str | Path, kind: Kinds = None) -> Artifact:
    """Open an artifact and check that it is complete, readable and of the wanted kind.

    The data is not read here, so damaged data is noticed only when it is read: see `verify_artifact`.

    Raises:
      ArtifactError: One line that says what is wrong and what to do.
    """
    path = Path(path)
    wanted = (kind,) if isinstance(kind, str) else kind
    check_is_file(path, wanted)
    identity = _identity(path)
    with naming(path), undamaged("is truncated or damaged"), hdf5.open_file(path) as file:
        fields = checked_fields(file, wanted)
        found, version = fields["kind"], fields["schema_version"]
        stored = checked_names(file)
        arrays = ArrayView(stored)
        migrate(fields, arrays)
        manifest = Manifest.from_fields(fields)
        if version >= DIGESTS_SINCE:
            _check_names(stored, manifest)
        artifact = Artifact(path, manifest, arrays.sources, identity)
        described = {name: artifact._describe(file, name) for name in arrays.sources}
        KINDS[found].check_config(manifest.config)
        problem = KINDS[found].problem(described)
        if problem:
            raise ArtifactError(f"{problem}: make it again with `{COMMANDS.get(found, 'ifo')}`")
    return artifact


def content_of(path: str | Path) -> str:
    """Return the digest of an artifact's content, as `Artifact.content` does.

    Raises:
      ArtifactError: The file cannot be read.
    """
    return read_artifact(path).content


def is_unchanged(parent: Parent, found: Artifact) -> bool:
    """Return whether an artifact has the content that a child recorded for its parent.

    The file is read completely (once) only if it or the record is of schema 1.
    """
    if parent.content:
        return parent.content == found.content
    return parent.sha256 == _sha256(found.path, _identity(found.path))


def checked_parent(child: Path, parent: Parent, kind: Kinds = None) -> Artifact:
    """Open a parent, and check that it has the content that the child recorded.

    What is checked is what is returned: a file that replaces it afterwards is refused when its data are read.

    Raises:
      ArtifactError: The parent is missing, unreadable, of another kind, or has other content.
    """
    path = _existing_parent(child, parent)
    found = read_artifact(path, kind)
    if not is_unchanged(parent, found):
        raise ArtifactError(
            f"{child} was made from {path}, which has changed since: put the old file back, or make {child.name} again"
        )
    return found


@contextmanager
def open_unchanged(artifact: Artifact) -> Iterator[Any]:
    """Open the HDF5 file of an artifact; errors in the block name the file.

    Raises:
      ArtifactError: The file was replaced since `read_artifact`, or cannot be opened.
    """
    with naming(artifact.path):
        if _identity(artifact.path) != artifact._identity:
            raise ArtifactError(REPLACED)
        with undamaged("cannot be opened"), hdf5.open_file(artifact.path) as file:
            yield file


def check_finite(name: str, array: np.ndarray) -> None:
    """Check that no value of a dataset is NaN or infinite."""
    if not is_finite(array):
        raise ArtifactError(f"dataset {name} holds values that are NaN or infinite: make the file again")


def check_is_file(path: Path, wanted: tuple[str, ...] | None = None) -> None:
    """Check that a path leads to an HDF5 file, without opening anything else.

    Raises:
      ArtifactError: It does not, or cannot be read; the message says how to make the wanted kinds.
    """
    try:
        check_regular(path)
        with open(path, "rb") as file:
            start = file.read(len(hdf5.SIGNATURE))
    except IsADirectoryError as error:
        raise ArtifactError(f"{path}: is a folder: {how_to_make(wanted)}") from error
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: no such file: {how_to_make(wanted, missing=True)}") from error
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    if start != hdf5.SIGNATURE:
        raise ArtifactError(f"{path}: is not HDF5, so not an ifo artifact: {how_to_make(wanted)}")


def checked_fields(file: Any, wanted: tuple[str, ...] | None = None) -> dict[str, Any]:
    """Return the manifest's fields as stored in the file, of a kind and a schema that this ifo can read.

    Raises:
      ArtifactError: It has no manifest, a damaged one, or one of another kind or a newer schema. Without the file's
        name.
    """
    fields = _stored_fields(file, wanted)
    found, version = fields["kind"], fields["schema_version"]
    if wanted is not None and found not in wanted:
        raise ArtifactError(f"is {a_(found)}, expected {either(wanted)}: {how_to_make(wanted)}")
    if found not in KINDS:
        raise ArtifactError(f"is {a_(found)}, which this ifo does not know: upgrade ifo")
    if version > KINDS[found].version:
        raise ArtifactError(
            f"was written by a newer ifo (schema {version}, this one reads up to {KINDS[found].version}): upgrade ifo"
        )
    return fields


def _stored_fields(file: Any, wanted: tuple[str, ...] | None = None) -> dict[str, Any]:
    """Return the manifest's fields as stored in the file."""
    attributes = hdf5.read_attributes(file)
    if "kind" not in attributes or "schema_version" not in attributes or DIGEST not in attributes:
        raise ArtifactError(f"is HDF5 but not an ifo artifact: {how_to_make(wanted)}")
    if attributes_digest(attributes) != attributes[DIGEST]:
        raise ArtifactError("has a damaged manifest: restore the file or make it again")
    fields = decode_attributes(attributes)
    kind, version = fields["kind"], fields["schema_version"]
    if not isinstance(kind, str) or len(kind) > LONGEST_KIND or not isinstance(version, int):
        raise ArtifactError(f"is HDF5 but not an ifo artifact: {how_to_make(wanted)}")
    return fields


def _check_names(stored: list[str], manifest: Manifest) -> None:
    """Raise ArtifactError if the file does not hold exactly the datasets that its manifest lists."""
    missing = sorted(manifest.datasets.keys() - set(stored))
    unknown = sorted(set(stored) - manifest.datasets.keys())
    if missing:
        raise ArtifactError(f"dataset {missing[0]} is missing: restore the file or make it again")
    if unknown:
        raise ArtifactError(f"dataset {unknown[0]} is not in the manifest: ifo did not write it like this")


def _existing_parent(child: Path, parent: Parent) -> Path:
    """Return the parent's path, or raise an ArtifactError that names both files."""
    path = parent_path(child, parent)
    if is_missing(path):
        raise ArtifactError(
            f"{child} was made from {path}, which is missing: put that file back, or make both again "
            f"(`{COMMANDS.get(parent.kind, 'ifo')}`)"
        )
    return path


def _identity(path: Path) -> Identity | None:
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


@functools.lru_cache(maxsize=1024)
def _content_of_old(path: Path, identity: Identity | None) -> str:
    """Return the content digest of a file of schema 1, computed from the stored data, independent of migrations."""
    with naming(path):
        if _identity(path) != identity:
            raise ArtifactError(REPLACED)
    with naming(path), undamaged("is truncated or damaged"), hdf5.open_file(path) as file:
        fields = _stored_fields(file)
        datasets = {name: hdf5.dataset_digest(file[name]) for name in checked_names(file)}
        parents = [parent["sha256"] for parent in fields["parents"]]
        return content_digest(
            fields["kind"], fields["schema_version"], datasets, fields["config"], int(fields["seed"]), parents
        )


@functools.lru_cache(maxsize=1024)
def _sha256(path: Path, identity: Identity | None) -> str:
    """Return the SHA-256 of a file; the identity is part of the cache key, so a changed file is read again."""
    return sha256_of(path)
