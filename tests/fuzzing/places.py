"""A folder in memory for the files of targets, and artifacts to start from."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from artifacts import hdf5, read_artifact
from artifacts.schema import DIGEST, attributes_digest
from tests.fuzzing.memory import GIVEN, IN_MEMORY, PREFIX

FIXTURES = Path(__file__).parents[1] / "fixtures"
OLD = sorted((FIXTURES / "v1").glob("*.h5"))
MOST_DIGESTED = 1 << 20  # bytes; more than a hostile shape is worth


@cache
def place(name: str = "") -> Path:
    """Return a folder of this process that is removed at its end, on a file system in memory where there is one.

    A process that may end without its clean-up is given the folder by the one that started it.
    """
    if not name:
        if given := os.environ.get(GIVEN):
            return Path(given)
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=IN_MEMORY))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        return folder
    folder = place() / name
    folder.mkdir()
    return folder


@cache
def old_and_new() -> tuple[tuple[Path, dict[str, Any], dict[str, np.ndarray]], ...]:
    """Return small artifacts of each kind, as schema 1 and as today's: path, root attributes and arrays.

    Arrays are cut to their first elements, as far as their kinds allow it.
    """
    found = []
    for path in OLD:
        artifact = read_artifact(path)
        with h5py.File(path) as file:
            attributes = hdf5.read_attributes(file)
        arrays = {name: small(artifact[name]) for name in artifact.names("")}
        found += [(path, attributes, arrays), (path, artifact.manifest.to_attributes(), arrays)]
    return tuple(found)


def small(array: np.ndarray) -> np.ndarray:
    """Return the first element along each axis with more than eight."""
    return array[tuple(slice(1) if length > 8 else slice(None) for length in array.shape)]


def store(path: Path, attributes: dict[str, Any], write: Any, *, digests: bool = True) -> Path:
    """Write an HDF5 file with these root attributes, and right digests if it is of a schema that has them.

    Args:
        write: Stores the datasets in the open file.
        digests: Whether the digests in the manifest are made right.
    """
    import json

    path.unlink(missing_ok=True)
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        write(file)
        attributes = {name: value for name, value in attributes.items() if name != DIGEST}
        if digests and attributes.get("schema_version") == 2:
            names: list[str] = []
            file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
            attributes["datasets"] = json.dumps({name: digest_of(file[name]) for name in names})
        for name, value in (*attributes.items(), (DIGEST, attributes_digest(attributes))):
            try:
                hdf5.write_attributes(file, {name: value})
            except (ValueError, TypeError, AttributeError, OverflowError, OSError):  # HDF5 cannot hold it.
                file.attrs[name] = np.void(b"\0\1")
    return path


def digest_of(dataset: Any) -> str:
    """Return the digest of a dataset, or an empty one where none can be computed."""
    try:
        return hdf5.dataset_digest(dataset) if dataset.nbytes <= MOST_DIGESTED else ""
    except Exception:
        return ""
