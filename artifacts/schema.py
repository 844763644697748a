"""The schema of artifacts: the manifest, and the datasets that each kind must hold."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from artifacts.errors import ArtifactError

DIGEST = "manifest_sha256"
JSON_FIELDS = ("config", "parents", "environment", "datasets", "recipe", "summary")
INT64 = range(-(2**63), 2**63)
DIGESTS_SINCE = 2  # first schema version with a digest of each dataset and of the content
SCHEMA = 2  # current schema version of every kind

# Values that differ between two runs of the same command with the same seed: measured times and file names. Patterns
# for datasets have the form KIND/NAME, for configurations KIND/KEY/KEY, where the key of a list item is its index.
VOLATILE_DATASETS = ("*/curve/seconds",)
VOLATILE_CONFIG = ("*/seconds", "*/minutes", "*/learning_minutes", "evaluation/runs/*/policy")


class Parent(BaseModel):
    """A file that an artifact was made from.

    Attributes:
      kind: Kind of that file.
      path: Path relative to the artifact's folder.
      content: Digest of that file's content; empty if recorded by schema 1.
      sha256: Digest of that file's bytes, recorded only by schema 1.
    """

    model_config = ConfigDict(frozen=True)

    kind: str
    path: str
    content: str = ""
    sha256: str = ""

    @property
    def digest(self) -> str:
        """The recorded digest: of the content if known, otherwise of the bytes."""
        return self.content or self.sha256


class Manifest(BaseModel):
    """The origin of an artifact: the root attributes, which are the same for every kind.

    Attributes:
      kind: One of `KINDS`.
      schema_version: Schema version of the data as it is read; older files are migrated.
      created: Time of creation, UTC, ISO 8601.
      ifo_version: Version of ifo that wrote the file.
      config: The stage's complete configuration, JSON values.
      seed: Seed of the run.
      command: The command line.
      parents: The files that the artifact was made from.
      environment: Versions and devices.
      datasets: Name of each dataset in the file -> its digest; empty in files of schema 1.
      content: Digest of the content, independent of when, where and in which environment the artifact was made;
        empty in files of schema 1 (`Artifact.content` computes it).
      recipe: The requested stage, configuration, seed and inputs, from `recipe_of`.
      summary: Figures that the stage printed; not part of the content.
    """

    model_config = ConfigDict(frozen=True)

    kind: str
    schema_version: int
    created: str
    ifo_version: str
    config: dict[str, Any]
    seed: int
    command: str
    parents: list[Parent]
    environment: dict[str, str]
    datasets: dict[str, str] = {}
    content: str = ""
    recipe: dict[str, Any] = {}
    summary: dict[str, Any] = {}

    def to_attributes(self) -> dict[str, int | str]:
        """Return the HDF5 root attributes, including a digest of all others.

        The digest is needed because HDF5 has no checksum for large attributes.
        """
        attributes: dict[str, int | str] = {}
        fields = self.model_dump()
        fields["parents"] = [{key: value for key, value in parent.items() if value} for parent in fields["parents"]]
        for name, value in fields.items():
            if name in JSON_FIELDS:
                attributes[name] = json.dumps(json_values(value))
            elif isinstance(value, int) and value not in INT64:
                attributes[name] = str(value)
            else:
                attributes[name] = value
        # Characters that UTF-8 cannot encode (from a file name in another encoding) stay readable in the command.
        attributes["command"] = self.command.encode("utf-8", "backslashreplace").decode("utf-8")
        return {**attributes, DIGEST: attributes_digest(attributes)}

    @classmethod
    def from_fields(cls, fields: Mapping[str, Any]) -> Manifest:
        """Check decoded fields, and raise ArtifactError with the first problem, without the file's name."""
        try:
            return cls.model_validate(dict(fields))
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise ArtifactError(f"bad manifest: {where}: {first['msg']}") from error

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, int | str]) -> Manifest:
        """Return the manifest from root attributes (inverse of `to_attributes`); the digest is not checked here."""
        return cls.from_fields(decode_attributes(attributes))


def attributes_digest(attributes: Mapping[str, int | str]) -> str:
    """Return the SHA-256 of all attributes, whatever their names, except the digest itself."""
    rest = {name: value for name, value in attributes.items() if name != DIGEST}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def decode_attributes(attributes: Mapping[str, int | str]) -> dict[str, Any]:
    """Return the manifest's fields as plain values, decoded from JSON."""
    fields: dict[str, Any] = {name: value for name, value in attributes.items() if name != DIGEST}
    for name in JSON_FIELDS:
        if isinstance(fields.get(name), str):
            try:
                fields[name] = json.loads(fields[name])
            except ValueError as error:
                raise ArtifactError(f"bad manifest: {name} is not JSON: was it written by ifo?") from error
    return fields


def json_values(value: Any) -> Any:
    """Return configuration values as they are read back from a file: tuples as lists, paths as text, plain numbers.

    Raises:
      TypeError: A value cannot be part of a configuration.
    """
    return json.loads(json.dumps(value, default=_plain))


def _plain(value: Any) -> Any:
    """Convert paths and NumPy values to JSON values."""
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{value!r} ({type(value).__name__}) cannot be part of a configuration: use plain values")


@dataclass(frozen=True)
class DatasetSpec:
    """Axes and types of a dataset.

    Attributes:
      axes: A name or a fixed length per axis; the same name means the same length throughout the file. None: any shape.
      dtypes: Exact names ("uint8") or NumPy kinds ("f"). Empty: any.
    """

    axes: tuple[str | int, ...] | None = None
    dtypes: tuple[str, ...] = ()

    @property
    def ndim(self) -> int | None:
        return None if self.axes is None else len(self.axes)

    def problem(self, shape: tuple[int, ...], dtype: np.dtype, lengths: dict[str, int]) -> str | None:
        """Describe why an array does not fit, or return None; `lengths` collects the lengths of the named axes."""
        if self.dtypes and dtype.name not in self.dtypes and dtype.kind not in self.dtypes:
            return f"is {dtype.name}, expected {self}"
        if self.axes is None:
            return None
        if len(shape) != len(self.axes):
            return f"has shape {shape}, expected {self}"
        for axis, length in zip(self.axes, shape, strict=True):
            wanted = axis if isinstance(axis, int) else lengths.setdefault(axis, length)
            if length != wanted:
                return f"has shape {shape}, expected {self} with {axis} = {wanted}"
        return None

    def __str__(self) -> str:
        names = {"f": "float", "uint8": "uint8"}
        dtypes = " or ".join(names.get(dtype, dtype) for dtype in self.dtypes) or "any type"
        return dtypes if self.axes is None else f"{dtypes} ({', '.join(map(str, self.axes))})"


@dataclass(frozen=True)
class KindSpec:
    """The datasets that a kind of artifact must hold; it may hold more.

    Attributes:
      version: The schema version that is written, and the newest that can be read.
      datasets: Required datasets; a name ending in `/*` means at least one dataset in that group.
      optional: Datasets that may be missing.
    """

    version: int = SCHEMA
    datasets: Mapping[str, DatasetSpec] = field(default_factory=dict)
    optional: Mapping[str, DatasetSpec] = field(default_factory=dict)

    def problem(self, found: Mapping[str, tuple[tuple[int, ...], np.dtype]]) -> str | None:
        """Describe the first missing or mismatching dataset among name -> (shape, dtype), or return None."""
        lengths: dict[str, int] = {}
        for wanted, spec in {**self.datasets, **self.optional}.items():
            if wanted.endswith("/*"):
                names = [name for name in found if name.startswith(wanted[:-1])]
            else:
                names = [wanted] if wanted in found else []
            if not names and wanted in self.datasets:
                return f"dataset {wanted} is missing, expected {spec}"
            for name in names:
                problem = spec.problem(*found[name], lengths)
                if problem:
                    return f"dataset {name} {problem}"
        return None


_WEIGHTS = {"weights/*": DatasetSpec()}

KINDS: dict[str, KindSpec] = {
    "expert": KindSpec(SCHEMA, _WEIGHTS),
    "demos": KindSpec(
        SCHEMA,
        {"frames": DatasetSpec(("N", "T", "H", "W", 3), ("uint8",))},
        # Simulated demonstrations have distances; imported ones have the time stamps of their frames.
        {"final_distance": DatasetSpec(("N",), ("f",)), "times": DatasetSpec(("N", "T"), ("f",))},
    ),
    "translator": KindSpec(SCHEMA, _WEIGHTS),
    "translation": KindSpec(
        SCHEMA,
        {
            "context_frame": DatasetSpec(("H", "W", 3), ("uint8",)),
            "target_features": DatasetSpec(("T", "D"), ("f",)),
            "target_images": DatasetSpec(("T", "H", "W", 3), ("uint8", "f")),
        },
    ),
    "policy": KindSpec(SCHEMA, _WEIGHTS),
    "evaluation": KindSpec(SCHEMA, {"final_distance": DatasetSpec(("R", "E"), ("f",))}),
    "checkpoint": KindSpec(SCHEMA),
}


class Config(dict[str, Any]):
    """A configuration in which a missing key is an error of the file, not a bug."""

    def __init__(self, path: Path, values: dict[str, Any]):
        super().__init__(values)
        self._path = path

    def __missing__(self, key: str) -> Any:
        raise ArtifactError(f"{self._path}: its configuration lacks {key!r}: make the file again with this ifo")
