"""Trees and checkpoints come back exactly."""

from __future__ import annotations

import random
import struct
from collections import OrderedDict
from types import SimpleNamespace

import hypothesis.extra.numpy as npst
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from artifacts import (
    ArtifactError,
    checkpoint_path,
    pack,
    read_checkpoint,
    remove_checkpoint,
    unpack,
    write_checkpoint,
)
from tests.artifacts.samples import PROVENANCE

numbers = st.one_of(
    npst.boolean_dtypes(),
    npst.integer_dtypes(),
    npst.unsigned_integer_dtypes(),
    npst.floating_dtypes(),
    npst.complex_number_dtypes(),
)
array_types = st.one_of(numbers, npst.byte_string_dtypes(), npst.unicode_string_dtypes(endianness="="))
scalars = st.one_of(numbers, npst.datetime64_dtypes()).flatmap(lambda dtype: npst.arrays(dtype, ()))
leaves = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.integers(min_value=2**62, max_value=2**700),
    st.floats(),
    st.text(st.characters()),
    st.binary(),
    scalars.map(lambda array: array[()]),
    st.text("ab", max_size=3).map(np.str_),
    npst.arrays(array_types, npst.array_shapes(min_dims=0, min_side=0, max_dims=3, max_side=3)),
)
keys = st.one_of(st.text(max_size=5), st.integers())
trees = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.lists(inner, max_size=4).map(tuple),
        st.dictionaries(keys, inner, max_size=4),
    ),
    max_leaves=12,
)


def same(a, b):
    """Equal to the bit, types and order of keys included."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray | np.generic) and not isinstance(a, str | bytes):
        return (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
    if isinstance(a, dict):
        return same(list(a.items()), list(b.items()))
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, float):
        return struct.pack("d", a) == struct.pack("d", b)
    return a == b


@settings(max_examples=60, deadline=None)
@given(trees)
@example([float("nan"), float("inf"), -float("inf"), -0.0, 2**700, b"", np.float32("nan"), np.str_(""), ()])
def test_unpack_undoes_pack(tree):
    text, arrays = pack(tree)
    assert text.isascii()
    assert same(unpack(text, arrays), tree)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(trees)
def test_a_checkpoint_brings_any_tree_back(tmp_path, tree):
    path = write_checkpoint(tmp_path / "x.checkpoint.h5", tree, stage="translator", **PROVENANCE)
    manifest, found = read_checkpoint(path, stage="translator")
    assert same(found, tree)
    assert manifest.kind == "checkpoint" and manifest.config == PROVENANCE["config"]


def test_random_states_continue_where_they_stopped(tmp_path):
    generator, python = np.random.default_rng(3), random.Random(3)
    mersenne = np.random.Generator(np.random.MT19937(3))
    generator.random(5), python.random(), mersenne.random(3)
    state = {
        "generator": generator.bit_generator.state,
        "mersenne": mersenne.bit_generator.state,
        "python": python.getstate(),
    }
    path = write_checkpoint(tmp_path / "x.checkpoint.h5", state, stage="s", **PROVENANCE)
    _, found = read_checkpoint(path, stage="s")
    other, other_python = np.random.default_rng(), random.Random()
    other_mersenne = np.random.Generator(np.random.MT19937())
    other.bit_generator.state = found["generator"]
    other_mersenne.bit_generator.state = found["mersenne"]
    other_python.setstate(found["python"])
    assert other.random() == generator.random()
    assert other_mersenne.random() == mersenne.random()
    assert other_python.random() == python.random()


def test_enormous_integers_and_ordered_dicts():
    tree = OrderedDict(big=7**9000, negative=-(7**9000))
    assert unpack(*pack(tree)) == dict(tree)


@pytest.mark.parametrize("value", [{1, 2}, SimpleNamespace(), np.array([None]), {True: 1}, {(1,): 1}, range(3)])
def test_what_cannot_be_kept_is_refused_by_place(value):
    with pytest.raises(TypeError, match=r"tree\['state'\]\[1\]"):
        pack({"state": [0, value]})


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        '{"a": 1, "b": 2}',
        "{}",
        '{"pickle": "x"}',
        '{"array": "missing"}',
        '{"int": 3}',
        '{"float": "00"}',
        '{"scalar": ["O", "00"]}',
        '{"scalar": ["<f8", "00"]}',
        '{"dict": [[[1], 2]]}',
        '{"bytes": "?"}',
        '{"scalar": []}',
        '{"scalar": ["<f8"]}',
        '{"scalar": ["(", "00"]}',
        '{"scalar": ["<f8,<f8", "00"]}',
        '{"scalar": 3}',
        '{"tuple": 3}',
        '{"array": []}',
        '{"dict": {"a": 1}}',
        '{"dict": [[1, 2, 3]]}',
        '{"numpy bytes": 3}',
        "[" * 100_000,
    ],
)
def test_a_strange_text_is_an_artifact_error(text):
    with pytest.raises(ArtifactError, match="malformed tree"):
        unpack(text, {})


def test_a_checkpoint_belongs_to_its_stage_and_artifact(tmp_path):
    out = tmp_path / "x.policy.h5"
    path = checkpoint_path(out)
    assert path == tmp_path / "x.policy.checkpoint.h5"
    with pytest.raises(ArtifactError, match="no such file"):
        read_checkpoint(path, stage="learn-policy")
    write_checkpoint(path, {"i": 1}, stage="learn-policy", **PROVENANCE)
    with pytest.raises(ArtifactError, match="is a checkpoint of learn-policy, expected one of translate"):
        read_checkpoint(path, stage="translate")
    (tmp_path / f".{path.name}.tmp-abandoned").mkdir()  # A killed writer leaves this.
    remove_checkpoint(out)
    remove_checkpoint(out)
    assert list(tmp_path.iterdir()) == []
