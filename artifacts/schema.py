"""The manifest of artifacts, as it is stored in the root attributes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from artifacts.errors import ArtifactError

DIGEST = "manifest_sha256"
JSON_FIELDS = ("config", "parents", "environment", "datasets", "recipe", "summary")
MOST_NESTED = 32  # lists and mappings in lists and mappings
MOST_DIGITS = 100  # of a number in the manifest
MOST_PARENTS = 10_000
INT64 = range(-(2**63), 2**63)

# Values that differ between two runs of the same command with the same seed: measured times and file names. Patterns
# for datasets have the form KIND/NAME, for configurations KIND/KEY/KEY, where the key of a list item is its index.
VOLATILE_DATASETS = ("*/curve/seconds",)
VOLATILE_CONFIG = ("*/seconds", "*/minutes", "*/learning_minutes", "evaluation/runs/*/policy")


Word = Annotated[str, Field(max_length=200)]


def _path(text: str) -> str:
    if "\0" in text:
        raise ValueError("a path cannot contain NUL")
    return text


def _shallow(values: dict[str, Any]) -> dict[str, Any]:
    if _is_deep(values, MOST_NESTED):
        raise ValueError("it is nested too deeply")
    return values


def _is_deep(value: Any, room: int) -> bool:
    if not isinstance(value, dict | list | tuple):
        return False
    return room == 0 or any(_is_deep(one, room - 1) for one in (value.values() if isinstance(value, dict) else value))


Values = Annotated[dict[str, Any], AfterValidator(_shallow)]


def _recipe(values: dict[str, Any]) -> dict[str, Any]:
    if not isinstance(values.get("config", {}), dict):
        raise ValueError("its config is no mapping")
    return values


class Parent(BaseModel):
    """A file that an artifact was made from.

    Attributes:
      kind: Kind of that file.
      path: Path relative to the artifact's folder.
      content: Digest of that file's content; empty if recorded by schema 1.
      sha256: Digest of that file's bytes, recorded only by schema 1.
    """

    model_config = ConfigDict(frozen=True)

    kind: Annotated[Word, Field(min_length=1)]
    path: Annotated[str, Field(min_length=1, max_length=4096), AfterValidator(_path)]
    content: Word = ""
    sha256: Word = ""

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

    kind: Word
    schema_version: int
    created: Word
    ifo_version: Word
    config: Values
    seed: Annotated[int, Field(ge=0)]
    command: str
    parents: Annotated[list[Parent], Field(max_length=MOST_PARENTS)]
    environment: dict[Word, str]
    datasets: dict[str, Word] = {}
    content: Word = ""
    recipe: Annotated[Values, AfterValidator(_recipe)] = {}
    summary: Values = {}

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
            raise ArtifactError(f"bad manifest: {first_problem(error)}: was it written by ifo?") from error

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, int | str]) -> Manifest:
        """Return the manifest from root attributes (inverse of `to_attributes`); the digest is not checked here."""
        return cls.from_fields(decode_attributes(attributes))


def first_problem(error: ValidationError) -> str:
    """Return what is wrong first, and where."""
    first = error.errors(include_url=False, include_input=False)[0]
    where = ".".join(map(str, first["loc"]))[:100]
    return f"{where}: {first['msg'].removeprefix('Value error, ')}"


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
                fields[name] = json.loads(fields[name], parse_int=_integer)
            except (ValueError, RecursionError) as error:
                raise ArtifactError(f"bad manifest: {name} is not JSON: was it written by ifo?") from error
    return fields


def _integer(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


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


class Config(dict[str, Any]):
    """A configuration in which a missing key is an error of the file, not a bug."""

    def __init__(self, path: Path, values: dict[str, Any]):
        super().__init__(values)
        self._path = path

    def __missing__(self, key: str) -> Any:
        raise ArtifactError(f"{self._path}: its configuration lacks {key!r}: make the file again with this ifo")
