"""The digest of an artifact's content, which shows whether two artifacts are the same."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from artifacts.schema import VOLATILE_CONFIG, VOLATILE_DATASETS


def content_digest(
    kind: str,
    schema_version: int,
    datasets: Mapping[str, str],
    config: Mapping[str, Any],
    seed: int,
    parents: Sequence[str],
) -> str:
    """Return the digest (SHA-256, hexadecimal) of an artifact's content, independent of when and where it was made.

    Args:
      kind: Kind of the artifact.
      schema_version: Schema version of the file.
      datasets: Name of each dataset -> its digest; measured times are left out.
      config: The configuration, JSON values; measured times and file names are left out.
      seed: Seed of the run.
      parents: Digests of the artifacts that it was made from.
    """
    known = {name: digest for name, digest in datasets.items() if not _is_volatile_dataset(kind, name)}
    content = [kind, schema_version, known, _without_volatile(kind, config), seed, list(parents)]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _is_volatile_dataset(kind: str, name: str) -> bool:
    return any(fnmatchcase(f"{kind}/{name}", pattern) for pattern in VOLATILE_DATASETS)


def _without_volatile(kind: str, config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration (JSON values) without the values that differ between two runs of the same command."""

    def kept(value: Any, where: str) -> Any:
        if isinstance(value, Mapping):
            inner = {key: f"{where}/{key}" for key in value}
            return {key: kept(value[key], at) for key, at in inner.items() if not _is_volatile(at)}
        if isinstance(value, list | tuple):
            return [kept(item, f"{where}/{i}") for i, item in enumerate(value)]
        return value

    return dict(kept(config, kind))


def _is_volatile(where: str) -> bool:
    return any(fnmatchcase(where, pattern) for pattern in VOLATILE_CONFIG)
