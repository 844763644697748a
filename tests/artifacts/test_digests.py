"""The digest of each dataset: damage that HDF5's checksum does not see, and any layout in memory."""

from __future__ import annotations

import tracemalloc

import h5py
import hypothesis.extra.numpy as npst
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from artifacts import ArtifactError, digests, hdf5, read_artifact, verify_artifact, write_artifact
from tests.artifacts.samples import PROVENANCE

SECTOR = 512


@pytest.fixture
def white_demos(tmp_path):
    """Demonstrations with white margins, and their frames."""
    frames = np.full((4, 25, 48, 48, 3), 255, np.uint8)
    frames[:, :, 16:32, 16:32] = np.random.default_rng(0).integers(0, 255, (4, 25, 16, 16, 3), np.uint8)
    frames[3] = 255
    arrays = {"frames": frames, "times": np.tile(np.arange(25.0) / 25, (4, 1))}
    return write_artifact(tmp_path / "white.demos.h5", "demos", arrays, **PROVENANCE), frames


def chunks_of(path, name):
    """(Offset, size) of each chunk's data in the file, without the checksum behind it."""
    with h5py.File(path) as file:
        dataset = file[name].id
        found = [dataset.get_chunk_info(k) for k in range(dataset.get_num_chunks())]
    return [(chunk.byte_offset, chunk.size - 4) for chunk in found]


def zeroed_sectors(data, chunks):
    """Zero the first three sectors that are white altogether, as a disk does that loses them."""
    done = 0
    for start in range(0, len(data), SECTOR):
        inside = any(offset <= start and start + SECTOR <= offset + size for offset, size in chunks)
        if done < 3 and inside and data[start : start + SECTOR] == b"\xff" * SECTOR:
            data[start : start + SECTOR] = bytes(SECTOR)
            done += 1
    assert done == 3


def zeroed_chunk(data, chunks):
    """Zero a chunk and its checksum."""
    offset, size = chunks[1]
    data[offset : offset + size + 4] = bytes(size + 4)


@pytest.mark.parametrize("zero", [zeroed_sectors, zeroed_chunk])
def test_zeroed_data_is_noticed(white_demos, zero):
    path, frames = white_demos
    data = bytearray(path.read_bytes())
    zero(data, chunks_of(path, "frames"))
    path.write_bytes(data)
    with h5py.File(path) as file:
        assert (file["frames"][...] != frames).any()  # HDF5 gives other data without a word.
    artifact = read_artifact(path)
    for function in (
        lambda: verify_artifact(path),
        lambda: artifact["frames"],
        lambda: artifact.read("frames", slice(None)),
        lambda: artifact.read("frames", (..., slice(None))),
    ):
        with pytest.raises(ArtifactError, match=r"white\.demos\.h5: dataset frames is damaged \(its digest is wrong\)"):
            function()
    assert artifact["times"].shape == (4, 25)


def test_a_group_is_checked_too(tmp_path):
    arrays = {"weights/a": np.ones((200, 200), np.uint8), "weights/b": np.full((400, 400), 255, np.uint8)}
    path = write_artifact(tmp_path / "x.policy.h5", "policy", arrays, **PROVENANCE)
    assert read_artifact(path).group("weights").keys() == {"a", "b"}
    data = bytearray(path.read_bytes())
    [(offset, size)] = chunks_of(path, "weights/b")
    data[offset : offset + size + 4] = bytes(size + 4)
    path.write_bytes(data)
    with pytest.raises(ArtifactError, match=r"x\.policy\.h5: dataset weights/b is damaged"):
        read_artifact(path).group("weights")


@pytest.mark.parametrize("block", [1, 7, 64, 10**6])
@pytest.mark.parametrize("shape", [(), (1,), (5,), (3, 4), (2, 3, 5), (1, 40, 3), (0, 3), (4, 1, 9)])
def test_blocks_cover_an_array_in_c_order(monkeypatch, shape, block):
    monkeypatch.setattr(digests, "BLOCK_BYTES", block)
    array = np.arange(np.prod(shape, dtype=int), dtype=np.int16).reshape(shape)
    for chunks in (None, shape, tuple(min(length, 2) for length in shape)):
        pieces = [array[selection] for selection in digests.blocks(shape, 2, chunks)]
        assert b"".join(piece.tobytes() for piece in pieces) == array.tobytes()
        assert all(piece.nbytes <= max(block, 2) for piece in pieces)
    assert len(list(digests.blocks(shape, 2))) <= np.ceil(array.nbytes / block) * 3 + 1


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(npst.arrays(np.float32, npst.array_shapes(max_dims=3, max_side=6)), st.permutations(range(3)), st.booleans())
def test_the_layout_in_memory_does_not_matter(tmp_path, array, order, reverse):
    view = array.transpose([axis for axis in order if axis < array.ndim])[:: -1 if reverse else 1]
    assert hdf5.digest_of(view) == hdf5.digest_of(view.copy(order="C"))
    path = write_artifact(tmp_path / "a.checkpoint.h5", "checkpoint", {"a": view}, **PROVENANCE)
    assert verify_artifact(path).datasets == 1
    assert read_artifact(path)["a"].tobytes() == view.tobytes()


def test_type_and_shape_are_part_of_the_digest():
    bytes_alike = [
        np.zeros(8, np.uint8),
        np.zeros(8, np.int8),
        np.zeros((2, 4), np.uint8),
        np.zeros((4, 2), np.uint8),
        np.zeros(1),
        np.zeros(()),
        np.array([b"\0" * 8], "S8"),
        np.array([""], "U8"),
        np.array([""], "U7"),
        np.zeros((0, 8)),
        np.zeros((8, 0)),
    ]
    assert len({hdf5.digest_of(array) for array in bytes_alike}) == len(bytes_alike)


def test_digests_do_not_drift():
    """Files on disk hold these digests: they must be the same on every machine and in every later version."""
    assert hdf5.digest_of(np.arange(6, dtype="<f4").reshape(2, 3)) == "2e4ffac722afcb16eb9a29f8938db9ce"
    assert hdf5.digest_of(np.array(["left", "né"])) == "898c68fb2c7fc5235ad2a608e102ef50"


def test_verify_needs_little_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(digests, "BLOCK_BYTES", 1 << 20)
    arrays = {"a": np.random.default_rng(0).integers(0, 256, (40, 1 << 19), np.uint8)}
    path = write_artifact(tmp_path / "a.checkpoint.h5", "checkpoint", arrays, **PROVENANCE)
    del arrays
    tracemalloc.start()
    try:
        verify_artifact(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 4 << 20
