"""The digest of an artifact's content, which tells whether two artifacts are the same."""

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
    """Return the digest (sha256, hexadecimal) of what an artifact is, whenever and wherever it was made.

    Args:
      kind: of the artifact.
      schema_version: that it was written in.
      datasets: name -> digest; measured times are left out.
      config: JSON values; measured times and names of files are left out.
      seed: of the run.
      parents: digests of the artifacts that it was made from.
    """
    known = {name: digest for name, digest in datasets.items() if not _is_volatile_dataset(kind, name)}
    content = [kind, schema_version, known, _without_volatile(kind, config), seed, list(parents)]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _is_volatile_dataset(kind: str, name: str) -> bool:
    return any(fnmatchcase(f"{kind}/{name}", pattern) for pattern in VOLATILE_DATASETS)


def _without_volatile(kind: str, config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration (JSON values) without what differs between two equal runs."""

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
