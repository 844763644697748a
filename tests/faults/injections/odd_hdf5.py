"""HDF5 files whose datasets have odd types, shapes, layouts and links; the digests are right."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.faults.case import Case, Verdict, kind
from tests.faults.injections.forged import forge, judge


def some_dataset(file: Any, rng: np.random.Generator) -> str:
    """Return the name of a random dataset."""
    import h5py

    names: list[str] = []
    file.visititems(lambda n, item: names.append(n) if isinstance(item, h5py.Dataset) else None)
    return sorted(names)[int(rng.integers(len(names)))]


def replaced(file: Any, rng: np.random.Generator, **options: Any) -> Any:
    """Replace a random dataset by another of the same name."""
    name = some_dataset(file, rng)
    del file[name]
    return file.create_dataset(name, **options)


def other_type(file: Any, rng: np.random.Generator) -> None:
    import h5py

    types = (
        np.dtype([("a", "i4"), ("b", "f8")]), h5py.string_dtype(), h5py.vlen_dtype(np.int32), h5py.ref_dtype,
        np.dtype("V7"), h5py.enum_dtype({"A": 1}), np.dtype("f2"), np.dtype("c16"), np.dtype((np.float32, (3,))),
        np.dtype("S100000"), np.dtype("i1"), np.dtype("bool"),
    )  # fmt: skip
    replaced(file, rng, shape=(3,), dtype=types[int(rng.integers(len(types)))])


def other_shape(file: Any, rng: np.random.Generator) -> None:
    shapes = ((), (0,), (0, 4), (1,) * 12, (7, 3), (10**6,), (1, 1, 1, 3))
    dtypes = ("f4", "f8", "u1", "i8")
    replaced(file, rng, shape=shapes[int(rng.integers(len(shapes)))], dtype=dtypes[int(rng.integers(4))])


def huge_unallocated(file: Any, rng: np.random.Generator) -> None:
    shapes = ((10**9, 1000), (2**40,), (10**5, 10**5, 3), (2**62,))
    replaced(
        file, rng, shape=shapes[int(rng.integers(4))], dtype="u1", chunks=True, fletcher32=bool(rng.random() < 0.5)
    )


def compressed(file: Any, rng: np.random.Generator) -> None:
    made = replaced(file, rng, shape=(2_000_000_000,), dtype="u1", chunks=(10**8,), compression="gzip")
    made[: 10**6] = 0


def short_chunks(file: Any, rng: np.random.Generator) -> None:
    name = some_dataset(file, rng)
    shape = file[name].shape or (1,)
    dtype = file[name].dtype
    del file[name]
    if 0 in shape:
        return
    made = file.create_dataset(name, shape, dtype, chunks=tuple(shape), fletcher32=bool(rng.random() < 0.7))
    made.id.write_direct_chunk((0,) * len(shape), rng.bytes(int(rng.integers(1, 9))))


def masked_filter(file: Any, rng: np.random.Generator) -> None:
    name = some_dataset(file, rng)
    array = np.atleast_1d(file[name][...])
    del file[name]
    if not array.size:
        return
    made = file.create_dataset(name, array.shape, array.dtype, chunks=array.shape, fletcher32=True)
    made.id.write_direct_chunk((0,) * array.ndim, array.tobytes(), filter_mask=1)


def nested_groups(file: Any, rng: np.random.Generator) -> None:
    group = file
    for _ in range(int(rng.integers(100, 10_000))):
        group = group.create_group("g")


def cycle_of_links(file: Any, rng: np.random.Generator) -> None:
    import h5py

    group = file.require_group("weights")
    group["itself"] = file["/"] if rng.random() < 0.5 else group
    group["soft"] = h5py.SoftLink("/weights/soft")


def many_links(file: Any, rng: np.random.Generator) -> None:
    name = some_dataset(file, rng)
    for number in range(int(rng.integers(1, 3_000))):
        file[f"links/{number}"] = file[name]


def outside_links(file: Any, rng: np.random.Generator) -> None:
    import h5py

    name = some_dataset(file, rng)
    targets = ("/etc/passwd", "/dev/zero", "x.expert.h5", "../../secret.h5")
    target = targets[int(rng.integers(4))]
    del file[name]
    if rng.random() < 0.5:
        file[name] = h5py.ExternalLink(target, "/")
    else:
        file.create_dataset(name, (16,), "u1", external=[(target, 0, 16)])


def hostile_dataset_attributes(file: Any, rng: np.random.Generator) -> None:
    items = ("text", -1, 2**40, np.zeros(3), np.float64("nan"), np.void(b"abc"), np.zeros((2, 2), "S5"))
    name = some_dataset(file, rng)
    for key in ("scalar", "unicode"):
        if rng.random() < 0.7:
            file[name].attrs[key] = items[int(rng.integers(len(items)))]


CHANGES = (
    other_type, other_shape, huge_unallocated, compressed, short_chunks, masked_filter, nested_groups,
    cycle_of_links, many_links, outside_links, hostile_dataset_attributes,
)  # fmt: skip


@kind("hostile datasets", 50)
def hostile_datasets(case: Case) -> Verdict:
    """Datasets of odd types, shapes, layouts and links."""
    name = case.choose(case.originals.files)
    path = case.damage(name)
    change = case.choose(CHANGES)
    seed = int(case.rng.integers(2**31))
    forge(path, datasets=lambda file: change(file, np.random.default_rng(seed)))
    return judge(case, name, f"{name}: {change.__name__.replace('_', ' ')} (random seed {seed})")
