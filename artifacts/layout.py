"""Checks of how a file stores its arrays and attributes, before HDF5 reads any of them.

HDF5 trusts what a file says about itself: a stored chunk that is shorter than its checksum ends the process (SIGSEGV),
chunks that are not stored are filled up to any size, and a filter may inflate a few bytes to gigabytes or load a
plug-in. Files are therefore accepted only with the one layout that `artifacts.hdf5` writes, in which all data is stored
exactly once. What a file costs in memory is then at most what it has in bytes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from artifacts.errors import ArtifactError

if TYPE_CHECKING:
    import h5py
    import numpy as np

STORABLE = "biufcSU"
CHECKSUM_BYTES = 4  # fletcher32, stored after each chunk
MOST_NESTED = 32  # parts of a name
MOST_MANIFEST_BYTES = 4 << 20
MOST_DECODED_BYTES = 64 << 20  # of an array of strings that are stored shorter than their type is wide


def checked_names(file: h5py.File) -> list[str]:
    """Check the layout of every dataset, and return their names, sorted; links to other files are not followed.

    Raises:
      ArtifactError: ifo did not write the file like this, or a dataset is incomplete.
    """
    names, room = [], file.id.get_filesize()
    for name, dataset in _datasets(file):
        room -= _stored_bytes(name, dataset, room)
        names.append(name)
    return sorted(names)


def check_attributes(file: h5py.File) -> None:
    """Check that the root attributes are integers and short strings of a fixed length.

    Raises:
      ArtifactError: An attribute is something else, or too long.
    """
    import h5py

    room = MOST_MANIFEST_BYTES
    for index in range(h5py.h5a.get_num_attrs(file.id)):
        attribute = h5py.h5a.open(file.id, index=index)
        kind = attribute.get_type()
        text = isinstance(kind, h5py.h5t.TypeStringID) and not kind.is_variable_str()
        if attribute.shape != () or not (text or isinstance(kind, h5py.h5t.TypeIntegerID)):
            raise ArtifactError("has an attribute that is neither a number nor a text: ifo did not write it like this")
        room -= kind.get_size()
    if room < 0:
        raise ArtifactError(f"has a manifest of more than {MOST_MANIFEST_BYTES >> 20} MiB: do not trust this file")


def _datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Yield all datasets with their names, without recursion, and each object once."""
    import h5py

    groups, seen = [("", 1, file)], {h5py.h5o.get_info(file.id).addr}
    while groups:
        prefix, depth, group = groups.pop()
        for part in group:
            if group.id.links.get_info(part.encode("utf-8", "surrogateescape")).type != h5py.h5l.TYPE_HARD:
                continue
            name, item = f"{prefix}{part}", group[part]
            address = h5py.h5o.get_info(item.id).addr
            if address in seen or depth > MOST_NESTED:
                raise ArtifactError(
                    "has objects with several names or groups nested too deeply: ifo did not write it like this"
                )
            seen.add(address)
            if isinstance(item, h5py.Group):
                groups.append((f"{name}/", depth + 1, item))
            elif isinstance(item, h5py.Dataset):
                yield name, item


def _stored_bytes(name: str, dataset: h5py.Dataset, room: int) -> int:
    """Return the stored size of a dataset that is stored like ifo does it, in at most `room` bytes."""
    import h5py

    foreign = ArtifactError(f"dataset {name} is not stored the way ifo stores arrays: do not trust this file")
    dtype, shape, layout = dataset.dtype, dataset.shape, dataset.id.get_create_plist()
    if dtype.kind not in STORABLE or dtype.itemsize != dataset.id.get_type().get_size() or shape is None:
        raise foreign
    if layout.get_layout() == h5py.h5d.VIRTUAL or layout.get_external_count():
        raise foreign
    if "scalar" in dataset.attrs and (_number(dataset, "scalar") is None or shape != (1,)):
        raise foreign
    stored = 0
    if 0 not in shape:
        filters = [layout.get_filter(index)[0] for index in range(layout.get_nfilters())]
        if layout.get_layout() != h5py.h5d.CHUNKED or h5py.h5z.FILTER_FLETCHER32 not in filters:
            raise ArtifactError(f"dataset {name} has no checksum: ifo did not write it like this")
        if len(filters) > 1:
            raise foreign
        stored = _checked_chunks(name, dataset, room)
    if "unicode" in dataset.attrs:
        width = _number(dataset, "unicode")
        decoded = math.prod(shape) * 4 * (width or 0)
        if width is None or dtype.kind != "S" or not 0 <= decoded <= max(MOST_DECODED_BYTES, 4 * stored):
            raise foreign
    return stored


def _checked_chunks(name: str, dataset: h5py.Dataset, room: int) -> int:
    """Return the stored size of a dataset, all of whose chunks must be there, complete and with their checksum."""
    size = math.prod(dataset.chunks) * dataset.dtype.itemsize + CHECKSUM_BYTES
    count = math.prod(-(-length // chunk) for length, chunk in zip(dataset.shape, dataset.chunks, strict=True))
    found: list[Any] = []
    if count * size <= room:  # otherwise it need not be looked for
        dataset.id.chunk_iter(found.append)
    if len(found) != count or any(chunk.size != size or chunk.filter_mask for chunk in found):
        raise ArtifactError(f"dataset {name} is damaged (its data is incomplete): restore the file or make it again")
    return count * size


def _number(dataset: h5py.Dataset, attribute: str) -> int | None:
    """Return an attribute that is a single positive integer; None: it is not."""
    import h5py

    found = h5py.h5a.open(dataset.id, attribute.encode())
    if found.shape != () or not isinstance(found.get_type(), h5py.h5t.TypeIntegerID):
        return None
    value: np.integer = dataset.attrs[attribute]
    return int(value) if value > 0 else None
