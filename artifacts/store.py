"""Write, read and verify artifacts."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import hdf5
from artifacts.atomic import atomic_path
from artifacts.errors import ArtifactError, IfoError
from artifacts.migrations import ArrayView, Source, migrate
from artifacts.paths import default_path, sha256_of, sibling, stem_of
from artifacts.schema import (
    COMMANDS,
    DIGEST,
    KINDS,
    Config,
    Manifest,
    Parent,
    attributes_digest,
    decode_attributes,
)
from artifacts.wording import a_, either, how_to_make

__all__ = [
    "Artifact",
    "VerifyReport",
    "default_path",
    "read_artifact",
    "sha256_of",
    "sibling",
    "stem_of",
    "verify_artifact",
    "write_artifact",
]

Kinds = str | tuple[str, ...] | None


def write_artifact(
    path: str | Path,
    kind: str,
    arrays: Mapping[str, np.ndarray],
    *,
    config: dict[str, Any],
    seed: int,
    command: str,
    parents: Sequence[str | Path] = (),
    environment: Mapping[str, str] | None = None,
) -> Path:
    """Write an artifact whole or not at all, replacing an older one of that name.

    Args:
      path: where, by custom `NAME.KIND.h5`; the folder is made if missing.
      kind: one of `KINDS`.
      arrays: dataset name (slashes make groups) -> array of numbers, booleans or strings.
      config: the stage's whole configuration, JSON values.
      seed: the run's seed.
      command: the command line as the user could repeat it.
      parents: the artifacts that this one was made from.
      environment: versions and devices.

    Raises:
      ArtifactError: the arrays are not what the kind holds, or a parent is unreadable. Nothing is written.
      PlatformError: the file cannot be written.
    """
    path = Path(path)
    arrays = {name: np.asarray(array) for name, array in arrays.items()}
    if kind not in KINDS:
        raise ArtifactError(f"{path}: {kind!r} is no kind of artifact: expected one of {', '.join(KINDS)}")
    with _naming(path):
        hdf5.check_arrays(arrays)
        problem = KINDS[kind].problem({name: (array.shape, array.dtype) for name, array in arrays.items()})
        if problem:
            raise ArtifactError(problem)
    manifest = Manifest(
        kind=kind,
        schema_version=KINDS[kind].version,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        ifo_version=_ifo_version(),
        config=config,
        seed=int(seed),
        command=command,
        parents=[_parent(parent, path) for parent in parents],
        environment={name: str(value) for name, value in (environment or {}).items()},
    )
    attributes = manifest.to_attributes()
    room = hdf5.room_for(arrays, attributes)
    with atomic_path(path) as temporary, hdf5.new_file(temporary, room) as file:
        hdf5.write_attributes(file, attributes)
        for name, array in arrays.items():
            hdf5.write_dataset(file, name, array)
    return path


class Artifact:
    """An artifact on disk. The file is open only during a read.

    Every read raises ArtifactError, naming file and dataset, when the data is damaged or the
    file was replaced since `read_artifact`.
    """

    def __init__(self, path: Path, manifest: Manifest, sources: dict[str, Source], identity: object) -> None:
        self.path = path
        self.manifest = manifest
        self._sources = sources
        self._identity = identity

    @property
    def kind(self) -> str:
        return self.manifest.kind

    @property
    def config(self) -> dict[str, Any]:
        """The stage's configuration; a key that is not there is an ArtifactError that names the file."""
        return Config(self.path, self.manifest.config)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.read(name)

    def __contains__(self, name: object) -> bool:
        return name in self._sources

    def __repr__(self) -> str:
        return f"<Artifact {self.path} ({self.kind}, {len(self._sources)} datasets)>"

    def names(self, prefix: str = "") -> list[str]:
        """Names of the datasets that start with `prefix`, sorted."""
        return sorted(name for name in self._sources if name.startswith(prefix))

    def describe(self) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
        """Shape and type of every dataset, without reading the data."""
        with self._open() as file:
            return {name: self._describe(file, name) for name in self.names()}

    def read(self, name: str, selection: Any = ...) -> np.ndarray:
        """Read a dataset, or the part that a NumPy-like selection (`slice(3)`, `(0, ...)`) names."""
        with self._open() as file:
            return self._read(file, name, selection)

    def group(self, prefix: str) -> dict[str, np.ndarray]:
        """Read all datasets under a group: names relative to it -> arrays; empty if there are none."""
        prefix = prefix.rstrip("/") + "/"
        with self._open() as file:
            return {name.removeprefix(prefix): self._read(file, name) for name in self.names(prefix)}

    def parent(self, kind: str, *, check: bool = False) -> Artifact:
        """Open the parent of that kind; with `check`, make sure that its sha256 is still the same."""
        for parent in self.manifest.parents:
            if parent.kind == kind:
                path = _parent_path(self.path, parent)
                if check:
                    _check_parent(self.path, parent)
                return read_artifact(path, kind)
        raise ArtifactError(f"{self.path} has no {kind} among its parents: {how_to_make(kind, 'pass')}")

    @contextmanager
    def _open(self) -> Iterator[Any]:
        with _naming(self.path):
            if _identity(self.path) != self._identity:
                raise ArtifactError("was replaced or removed while in use: run the command again")
            with _unharmed("cannot be opened"), hdf5.open_file(self.path) as file:
                yield file

    def _read(self, file: Any, name: str, selection: Any = ...) -> np.ndarray:
        if name not in self._sources:
            raise ArtifactError(f"has no dataset {name}: expected one of {', '.join(self.names()) or 'none'}")
        source = self._sources[name]
        if source.stored is None:
            return np.array(np.asarray(source.value)[selection])
        with _unharmed(f"dataset {source.stored} is damaged"):
            if source.transform is None:
                return hdf5.read_dataset(file[source.stored], selection)
            whole = hdf5.read_dataset(file[source.stored])
        return np.asarray(source.transform(whole)[selection])

    def _describe(self, file: Any, name: str) -> tuple[tuple[int, ...], np.dtype]:
        source = self._sources[name]
        if source.stored is not None and source.transform is None:
            return hdf5.describe(file[source.stored])
        array = self._read(file, name)
        return array.shape, array.dtype


def read_artifact(path: str | Path, kind: Kinds = None) -> Artifact:
    """Open an artifact and check that it is whole in form, of the wanted kind, and readable.

    Data is not read here, so damage to it shows when it is: see `verify_artifact`.

    Raises:
      ArtifactError: one line that says what is wrong and what to do.
    """
    path = Path(path)
    wanted = (kind,) if isinstance(kind, str) else kind
    _check_is_file(path, wanted)
    identity = _identity(path)
    with _naming(path), _unharmed("is truncated or damaged"), hdf5.open_file(path) as file:
        attributes = hdf5.read_attributes(file)
        if "kind" not in attributes or "schema_version" not in attributes or DIGEST not in attributes:
            raise ArtifactError(f"is HDF5 but no ifo artifact: {how_to_make(wanted, 'pass')}")
        if attributes_digest(attributes) != attributes[DIGEST]:
            raise ArtifactError("has a damaged manifest: restore the file or make it again")
        fields = decode_attributes(attributes)
        found, version = fields["kind"], fields["schema_version"]
        if not isinstance(found, str) or not isinstance(version, int):
            raise ArtifactError(f"is HDF5 but no ifo artifact: {how_to_make(wanted, 'pass')}")
        if wanted is not None and found not in wanted:
            raise ArtifactError(f"is {a_(found)}, expected {either(wanted)}: {how_to_make(wanted, 'pass')}")
        if found not in KINDS:
            raise ArtifactError(f"is {a_(found)}, which this ifo does not know: upgrade ifo")
        if version > KINDS[found].version:
            raise ArtifactError(
                f"was written by a newer ifo (schema {version}, "
                f"this one reads up to {KINDS[found].version}): upgrade ifo"
            )
        arrays = ArrayView(hdf5.dataset_names(file))
        migrate(fields, arrays)
        artifact = Artifact(path, Manifest.from_fields(fields), arrays.sources, identity)
        described = {name: artifact._describe(file, name) for name in arrays.sources}
        problem = KINDS[found].problem(described)
        if problem:
            raise ArtifactError(f"{problem}: make it again with `{COMMANDS.get(found, 'ifo')}`")
    return artifact


@dataclass(frozen=True)
class VerifyReport:
    """What `verify_artifact` found in order: `bytes` is the file's size."""

    path: Path
    kind: str
    datasets: int
    bytes: int
    parents: int


def verify_artifact(path: str | Path) -> VerifyReport:
    """Read every dataset, piece by piece, and check that each parent is there and unchanged.

    Raises:
      ArtifactError: the first problem, in one line.
    """
    artifact = read_artifact(path)
    with artifact._open() as file:
        names = hdf5.dataset_names(file)
        for name in names:
            with _unharmed(f"dataset {name} is damaged"):
                dataset = file[name]
                if dataset.size and not dataset.fletcher32:
                    raise ArtifactError(f"dataset {name} has no checksum: ifo did not write it like this")
                for piece in dataset.iter_chunks() if dataset.chunks else ():
                    dataset[piece]
    for parent in artifact.manifest.parents:
        _check_parent(artifact.path, parent)
    size = artifact.path.stat().st_size
    return VerifyReport(artifact.path, artifact.kind, len(names), size, len(artifact.manifest.parents))


def _check_is_file(path: Path, wanted: tuple[str, ...] | None) -> None:
    if path.is_dir():
        raise ArtifactError(f"{path}: is a folder: {how_to_make(wanted, 'pass')}")
    try:
        with open(path, "rb") as file:
            start = file.read(len(hdf5.SIGNATURE))
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: no such file: {how_to_make(wanted, 'make')}") from error
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    if start != hdf5.SIGNATURE:
        raise ArtifactError(f"{path}: is not HDF5, so no ifo artifact: {how_to_make(wanted, 'pass')}")


def _identity(path: Path) -> object:
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Put the file's name before the message of an ArtifactError."""
    try:
        yield
    except ArtifactError as error:
        joint = " " if str(error).startswith(("is ", "was ", "has ")) else ": "
        raise ArtifactError(f"{path}{joint}{error}") from error.__cause__


@contextmanager
def _unharmed(problem: str) -> Iterator[None]:
    """Turn what h5py raises on a damaged file into an ArtifactError."""
    try:
        yield
    except IfoError:
        raise
    except (OSError, RuntimeError, KeyError, UnicodeError) as error:
        reason = " ".join(str(error).split())
        raise ArtifactError(f"{problem} ({reason}): restore the file or make it again") from error


def _parent(parent: str | Path, child: Path) -> Parent:
    kind = read_artifact(parent).kind
    folder, target = child.parent.resolve(), Path(parent).resolve()
    if target == child.resolve():
        raise ArtifactError(f"{child}: would replace its own input: choose another --out")
    relative = Path(os.path.relpath(target, folder)).as_posix()
    return Parent(kind=kind, path=relative, sha256=sha256_of(target))


def _parent_path(child: Path, parent: Parent) -> Path:
    """The parent's path, or an ArtifactError that names both files."""
    path = Path(os.path.normpath(child.parent.resolve() / parent.path))
    path = Path(os.path.relpath(path)) if not child.is_absolute() else path
    if not path.is_file():
        raise ArtifactError(
            f"{child} was made from {path}, which is missing: put that file back, or make both again "
            f"(`{COMMANDS.get(parent.kind, 'ifo')}`)"
        )
    return path


def _check_parent(child: Path, parent: Parent) -> None:
    path = _parent_path(child, parent)
    try:
        changed = sha256_of(path) != parent.sha256
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    if changed:
        raise ArtifactError(
            f"{child} was made from {path}, which has changed since: put the old file back, or make {child.name} again"
        )


def _ifo_version() -> str:
    try:
        return metadata.version("ifo")
    except metadata.PackageNotFoundError:
        return "0.0.0+unknown"
