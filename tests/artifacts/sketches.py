"""Artifacts that are only a manifest, which takes a hundredth of the time that a whole file takes."""

from __future__ import annotations

import os
import time
from datetime import UTC, datetime
from pathlib import Path

import h5py
import numpy as np

from artifacts import STAGE_FILES, hdf5
from artifacts.schema import Manifest, Parent

DAY = 86400.0
STAGES = {files.writes: stage for stage, files in reversed(STAGE_FILES.items())}


def record(child, parent, content=None):
    """The record of a parent at a path, with the content that `sketch` gives it."""
    path, kind = Path(parent), Path(parent).name.split(".")[-2]
    return Parent(kind=kind, path=os.path.relpath(path, Path(child).parent), content=content or f"content of {path}")


def sketch(path, parents=(), kind=None, content=None, age=DAY, **fields):
    """Write a file NAME.KIND.h5 that is an artifact at a glance.

    Args:
        path: The file.
        parents: Paths of files made by `sketch`, or records of them.
        kind: Kind; None: as in the name.
        content: Digest of the content; None: derived from the path.
        age: Seconds since the file was made.
        fields: Fields of the manifest; `arrays`: datasets.
    """
    path = Path(path)
    kind = kind or path.name.split(".")[-2]
    arrays = fields.pop("arrays", {})
    stage = STAGES.get(kind, "learn-policy")
    made = time.time() - age
    manifest = Manifest(
        **{
            "kind": kind,
            "schema_version": 2,
            "created": datetime.fromtimestamp(made, UTC).isoformat(timespec="seconds"),
            "ifo_version": "0.1.0",
            "config": {"stage": stage, "task": "reach"},
            "seed": 0,
            "command": f"ifo {stage}",
            "parents": [parent if isinstance(parent, Parent) else record(path, parent) for parent in parents],
            "environment": {"python": "3"},
            "datasets": {name: hdf5.digest_of(np.asarray(array)) for name, array in arrays.items()},
            "content": content or f"content of {path}",
            "recipe": {"stage": stage, "config": {}},
            **fields,
        }
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        hdf5.write_attributes(file, manifest.to_attributes())
        for name, array in arrays.items():
            hdf5.write_dataset(file, name, np.asarray(array))
    os.utime(path, (made, made))
    return path
