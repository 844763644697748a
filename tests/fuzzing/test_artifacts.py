"""Targets: artifacts by hostile or careless authors. The digests are right, the content is not."""

from __future__ import annotations

import json
from typing import Any

import h5py
import numpy as np
from hypothesis import strategies as st

from artifacts import Artifact, IfoError, Manifest, pack, read_artifact, unpack, verify_artifact
from artifacts.migrations import ArrayView, migrate
from artifacts.schema import JSON_FIELDS, decode_attributes
from tests.fuzzing.places import old_and_new, place, store
from tests.fuzzing.targets import handled, numbers, run_ifo, scalars, target, texts, values

TAGS = ("dict", "tuple", "array", "int", "float", "bytes", "numpy str", "numpy bytes", "scalar", "unknown")
DTYPES = ("<f4", "<f8", "|u1", "<i8", "|b1", "<c8", "|S3", "<U2", "|V4", "<f2", "<M8[s]", "|S0", "<U0")

nodes = st.recursive(
    st.one_of(
        scalars,
        st.lists(st.sampled_from((*DTYPES, "O", "i4,i4", "(9,9)f8", "S99")) | texts, max_size=2),
        st.fixed_dictionaries({"array": st.sampled_from(("000000", "000001")) | scalars}),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.builds(lambda tag, content: {tag: content}, st.sampled_from(TAGS), inner),
        st.builds(lambda pairs: {"dict": pairs}, st.lists(st.lists(inner, min_size=2, max_size=2), max_size=3)),
    ),
    max_leaves=10,
)
arrays = st.builds(
    lambda dtype, shape: np.zeros(shape, dtype),
    st.sampled_from(DTYPES[:8]),
    st.lists(st.integers(0, 3), max_size=3).map(tuple),
)
trees = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.binary(max_size=5), arrays,
        st.floats(width=32).map(np.float32), st.integers(0, 255).map(np.uint8), st.text(max_size=3).map(np.str_),
        st.binary(max_size=3).map(np.bytes_),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.lists(inner, max_size=3).map(tuple),
        st.dictionaries(st.text(max_size=3) | st.integers(), inner, max_size=3),
    ),
    max_leaves=8,
)  # fmt: skip
changes = st.lists(st.tuples(st.integers(0, 400), st.one_of(st.just("delete"), values)), min_size=1, max_size=4)


@target("trees, not written by ifo", text=nodes.map(json.dumps) | texts)
def test_trees_of_others(text: str) -> None:
    handled(unpack, text, {"000000": np.zeros(2), "000001": np.zeros((), "<U3")})


@target("trees, there and back", tree=trees)
def test_trees_there_and_back(tree: Any) -> None:
    text, stored = pack(tree)
    again = unpack(text, stored)
    assert pack(again)[0] == text and type(again) is type(tree)
    assert all(found.tobytes() == stored[name].tobytes() for name, found in pack(again)[1].items())


def places_in(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the paths of all values in nested mappings and lists."""
    inner: list[tuple[Any, Any]] = []
    if isinstance(value, dict):
        inner = list(value.items())
    elif isinstance(value, list):
        inner = list(enumerate(value))
    return [path, *(found for key, item in inner for found in places_in(item, (*path, key)))]


def changed(fields: dict[str, Any], edits: list[tuple[int, Any]]) -> dict[str, Any]:
    """Return a copy of plain values in which some are replaced or missing."""
    fields = json.loads(json.dumps(fields))
    for number, value in edits:
        paths = places_in(fields)[1:]
        if not paths:
            break
        *way, last = paths[number % len(paths)]
        holder = fields
        for key in way:
            holder = holder[key]
        if isinstance(value, str) and value == "delete":
            del holder[last]
        else:
            holder[last] = value
    return fields


def stored_form(fields: dict[str, Any]) -> dict[str, Any]:
    return {name: json.dumps(value) if name in JSON_FIELDS else value for name, value in fields.items()}


@target("manifests", number=st.integers(0, 13), edits=changes)
def test_manifests(number: int, edits: list[tuple[int, Any]]) -> None:
    _, attributes, _ = old_and_new()[number]
    fields = changed(decode_attributes(attributes), edits)
    found = handled(lambda: Manifest.from_attributes(stored_form(fields)))
    if isinstance(found, Manifest):
        again = Manifest.from_attributes(found.to_attributes())
        assert again.to_attributes() == Manifest.from_attributes(again.to_attributes()).to_attributes()


@target("migrations", number=st.integers(0, 6), edits=changes, names=st.lists(texts, max_size=3))
def test_migrations(number: int, edits: list[tuple[int, Any]], names: list[str]) -> None:
    _, attributes, arrays = old_and_new()[2 * number]
    fields = decode_attributes(attributes)
    kind, version = fields["kind"], fields["schema_version"]
    # The two that are checked before a migration, and that a configuration is a mapping, as `Manifest` has it.
    fields = changed(fields, edits) | {"kind": kind, "schema_version": version}
    if handled(Manifest.from_fields, fields).__class__ is Manifest:
        handled(migrate, fields, ArrayView((*arrays, *names)))


uses = st.sampled_from(("read", "verify", "inspect", "inspect --json"))


@target("files with changed manifests", number=st.integers(0, 13), edits=changes, text=st.none() | texts, how=uses)
def test_files_with_changed_manifests(number: int, edits: list[tuple[int, Any]], text: str | None, how: str) -> None:
    _, attributes, arrays = old_and_new()[number]
    fields = stored_form(changed(decode_attributes(attributes), edits))
    if text is not None:
        fields[sorted(fields or {"config": ""})[edits[0][0] % max(1, len(fields))]] = text
    use(store(place("manifests") / "x.h5", fields, lambda file: write_all(file, arrays), digests=False), how)


def write_all(file: h5py.File, arrays: dict[str, np.ndarray]) -> None:
    from artifacts import hdf5

    for name, array in arrays.items():
        hdf5.write_dataset(file, name, array)


def use(path: Any, how: str) -> None:
    """Do with a file what commands do: open it and read all, verify or inspect it."""
    if how == "read":
        artifact = handled(read_artifact, path)
        for name in artifact.names("") if isinstance(artifact, Artifact) else ():
            found = handled(artifact.__getitem__, name)
            assert isinstance(found, IfoError) or found.shape == artifact.describe()[name][0]
        handled(verify_artifact, path)
    else:
        code, _, said = run_ifo(*how.split(), path)
        assert code in (0, 3) and (code == 0 or str(path) in said), said


odd_datasets = st.fixed_dictionaries(
    {
        "name": st.sampled_from(("frames", "weights/a", "tree", "a/b/c", "final_distance", "é", "x" * 300)),
        "shape": st.lists(st.sampled_from((0, 1, 2, 3, 5, 2**31, 2**40)), max_size=5).map(tuple),
        "dtype": st.sampled_from(("u1", "f4", "f8", "i8", "S3", "c8", "b1", ">f4", "f2", "S1000")),
        "chunks": st.booleans(),
        "filters": st.sampled_from(
            (
                {"fletcher32": True},
                {},
                {"compression": "gzip"},
                {"fletcher32": True, "shuffle": True},
                {"scaleoffset": 0},
            )
        ),
        "fill": st.booleans(),
        "attributes": st.dictionaries(st.sampled_from(("unicode", "scalar", "x")), numbers | texts, max_size=2),
        "link": st.sampled_from(("", "", "", "soft", "external", "hard", "vlen", "compound", "empty", "enum")),
    }
)


def write_odd(file: h5py.File, about: dict[str, Any]) -> None:
    """Store one dataset, or something else of its name, as far as HDF5 can."""
    name, shape, link = about["name"], about["shape"], about["link"]
    if name in file:
        return
    options: dict[str, Any] = dict(about["filters"])
    if about["chunks"] or options:
        options["chunks"] = tuple(min(max(length, 1), 4) for length in shape)
    try:
        if link == "soft":
            file[name] = h5py.SoftLink("/frames")
        elif link == "external":
            file[name] = h5py.ExternalLink("/dev/zero", "/")
        elif link == "hard":
            file[name] = file["/"]
        elif link == "empty":
            file[name] = h5py.Empty("f4")
        elif link in ("vlen", "compound", "enum"):
            types = {
                "vlen": h5py.vlen_dtype(np.uint8),
                "compound": np.dtype([("a", "f4"), ("b", "S2")]),
                "enum": h5py.enum_dtype({"a": 1, "b": 2}),
            }
            file.create_dataset(name, (2,), types[link])
        else:
            dataset = file.create_dataset(name, shape, about["dtype"], **options)
            if about["fill"] and dataset.size < 10_000:
                dataset[...] = 1
            for key, value in about["attributes"].items():
                dataset.attrs[key] = value
    except (ValueError, TypeError, OSError, OverflowError, RuntimeError, UnicodeError, MemoryError):
        return


@target(
    "files with odd datasets", number=st.integers(0, 13), odd=st.lists(odd_datasets, min_size=1, max_size=3), how=uses
)
def test_files_with_odd_datasets(number: int, odd: list[dict[str, Any]], how: str) -> None:
    _, attributes, arrays = old_and_new()[number]

    def write(file: h5py.File) -> None:
        replaced = {about["name"] for about in odd}
        write_all(file, {name: array for name, array in arrays.items() if name not in replaced})
        for about in odd:
            write_odd(file, about)

    use(store(place("datasets") / "x.h5", attributes, write), how)
