"""Artifacts as a hostile author would change them: what the manifest says of itself stays right."""

from __future__ import annotations

import json
import shutil
from unittest import mock

import h5py
import numpy as np

from artifacts import hdf5
from artifacts.schema import attributes_digest


def forge(source, target, edit=None, arrays=None, attributes=None, config=None, parents=None):
    """Copy `source` to `target`, change it, and bring its digests in line.

    Args:
        source: An artifact.
        target: The file to write.
        edit: Function of the open file, which changes anything in it.
        arrays: Datasets to replace, by name; their digests are right.
        attributes: Root attributes to replace.
        parents: The parents to record.
        config: Values of the configuration to replace; None: to remove.
    """
    shutil.copy(source, target)
    with h5py.File(target, "r+", libver=("v110", "v110")) as file:
        found = hdf5.read_attributes(file)
        if edit:
            edit(file)
        datasets = json.loads(found["datasets"])
        for name, array in (arrays or {}).items():
            if name in file:
                del file[name]
            hdf5.write_dataset(file, name, np.asarray(array))
            datasets[name] = hdf5.digest_of(np.asarray(array))
        found["datasets"] = json.dumps(datasets)
        if config:
            values = json.loads(found["config"]) | config
            found["config"] = json.dumps({key: value for key, value in values.items() if value is not None})
        if parents is not None:
            found["parents"] = json.dumps(parents)
        found.update(attributes or {})
        del found["manifest_sha256"]
        found["manifest_sha256"] = attributes_digest(found)
        for name in list(file.attrs):
            del file.attrs[name]
        with mock.patch.object(hdf5, "MOST_MANIFEST_BYTES", 1 << 40):
            hdf5.write_attributes(file, found)
    return target
