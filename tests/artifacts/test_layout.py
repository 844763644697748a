"""Files whose data is stored otherwise than ifo stores it are refused before HDF5 reads any of it."""

from __future__ import annotations

import subprocess
import sys

import h5py
import numpy as np
import pytest

from artifacts import ArtifactError, PlatformError, read_artifact, write_artifact
from artifacts.layout import MOST_MANIFEST_BYTES, MOST_NESTED
from tests.artifacts.forging import forge
from tests.artifacts.samples import FIXTURES, PROVENANCE, demos_arrays


def replace(file, name="frames", **options):
    """Store a dataset anew, with other options and without data."""
    shape, dtype = file[name].shape, file[name].dtype
    del file[name]
    return file.create_dataset(name, options.pop("shape", shape), options.pop("dtype", dtype), **options)


def short_chunk(file):
    made = replace(file, chunks=(1, 5, 8, 10, 3), fletcher32=True)
    for k in range(4):
        made.id.write_direct_chunk((k, 0, 0, 0, 0), b"ab")


def chunk_without_rest(file):
    made = replace(file, chunks=(1, 5, 8, 10, 3), fletcher32=True)
    for k in range(4):
        made.id.write_direct_chunk((k, 0, 0, 0, 0), bytes(1200))


def chunk_that_skips_the_checksum(file):
    made = replace(file, chunks=(1, 5, 8, 10, 3), fletcher32=True)
    for k in range(4):
        made.id.write_direct_chunk((k, 0, 0, 0, 0), bytes(1204), filter_mask=1)


def missing_chunk(file):
    made = replace(file, chunks=(1, 5, 8, 10, 3), fletcher32=True)
    made[:3] = 1


def nothing_stored(file):
    replace(file, shape=(10**9, 5, 8, 10, 3), chunks=(1, 5, 8, 10, 3), fletcher32=True)


def huge_elements(file):
    replace(file, "final_distance", dtype="S1000000000", shape=(3,), chunks=(1,), fletcher32=True)


def bomb(file):
    replace(file, chunks=(4, 5, 8, 10, 3), fletcher32=True, compression="gzip")[...] = 0


def without_checksum(file):
    values = file["frames"][...]
    replace(file, chunks=(4, 5, 8, 10, 3))[...] = values


def contiguous(file):
    replace(file)[...] = 1


def compact(file):
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_layout(h5py.h5d.COMPACT)
    del file["final_distance"]
    space = h5py.h5s.create_simple((4,))
    h5py.h5d.create(file.id, b"final_distance", h5py.h5t.NATIVE_DOUBLE, space, layout)


def virtual(file):
    del file["frames"]
    layout = h5py.VirtualLayout((4, 5, 8, 10, 3), np.uint8)
    layout[:] = h5py.VirtualSource("other.h5", "frames", (4, 5, 8, 10, 3))
    file.create_virtual_dataset("frames", layout)


def no_space(file):
    del file["frames"]
    file["frames"] = h5py.Empty("u1")


def scalar(file):
    del file["frames"]
    file["frames"] = np.uint8(3)


def not_scalar(file):
    file["frames"].attrs["scalar"] = 1


def scalar_of_other_type(file):
    file["frames"].attrs["scalar"] = [1, 2]


def wide_strings(file):
    del file["contexts/angle"]
    made = file.create_dataset("contexts/angle", data=np.array([b"a"]), fletcher32=True)
    made.attrs["unicode"] = 2**31 - 1


def strings_of_odd_width(file):
    file["contexts/angle"].attrs["unicode"] = "x"


def objects(file):
    del file["frames"]
    file["frames"] = ["a", "b"]


def second_name(file):
    file["other"] = file["frames"]


def cycle(file):
    file["contexts/again"] = file["contexts"]


def root_in_itself(file):
    file["again"] = file["/"]


def nested(file):
    file.create_group("/".join("g" * (MOST_NESTED + 1)))


REFUSED = r"forged\.demos\.h5.*(ifo did not write|do not trust|incomplete)"
FORGERIES = (
    *(short_chunk, chunk_without_rest, chunk_that_skips_the_checksum, missing_chunk, nothing_stored, huge_elements),
    *(bomb, without_checksum, contiguous, compact, virtual, no_space, scalar, not_scalar, scalar_of_other_type),
    *(wide_strings, strings_of_odd_width, objects, second_name, cycle, root_in_itself, nested),
)


@pytest.mark.parametrize("edit", FORGERIES, ids=lambda edit: edit.__name__)
def test_another_layout_is_refused_when_the_file_is_opened(demos, tmp_path, edit):
    path = forge(demos, tmp_path / "forged.demos.h5", edit)
    with pytest.raises(ArtifactError, match=REFUSED) as caught:
        read_artifact(path)
    assert "\n" not in str(caught.value)


def test_every_array_needs_its_own_bytes(demos, tmp_path):
    """Many chunks at one place in the file would cost many times the memory that the file has bytes."""
    path = write_artifact(tmp_path / "x.checkpoint.h5", "checkpoint", {"a": np.zeros(300_000, np.uint8)}, **PROVENANCE)
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        made = file.create_dataset("b", (10**6, 10**6), np.uint8, chunks=(1000, 1000), fletcher32=True)
        made[0, 0] = 1
    with pytest.raises(ArtifactError, match="dataset b is damaged"):
        read_artifact(path)


@pytest.mark.parametrize(
    "value",
    [
        h5py.Empty("f8"),
        np.array([1, 2]),
        np.float64(1.5),
        np.array(["a"], dtype=object),
        np.array((1, 2), dtype=[("a", "i4"), ("b", "i4")]),
        "variable",
    ],
    ids=repr,
)
def test_attributes_of_other_types_are_refused(demos, value):
    with h5py.File(demos, "r+") as file:
        file.attrs["seed"] = value
    with pytest.raises(ArtifactError, match=r"x\.demos\.h5 has an attribute that is neither a number nor a text"):
        read_artifact(demos)


def test_a_huge_manifest_is_neither_read_nor_written(demos, tmp_path):
    text = "x" * (MOST_MANIFEST_BYTES + 1)
    with pytest.raises(ArtifactError, match="manifest of more than 4 MiB"):
        read_artifact(forge(demos, tmp_path / "forged.demos.h5", attributes={"command": text}))
    with pytest.raises(ArtifactError, match="manifest would need more than 4 MiB"):
        write_artifact(tmp_path / "y.demos.h5", "demos", demos_arrays(), **{**PROVENANCE, "config": {"a": text}})
    assert not (tmp_path / "y.demos.h5").exists()


def test_what_is_written_can_be_read(tmp_path):
    nested = {"/".join("g" * (MOST_NESTED + 1)): np.zeros(3)}
    with pytest.raises(ArtifactError, match="nested"):
        write_artifact(tmp_path / "x.checkpoint.h5", "checkpoint", nested, **PROVENANCE)
    arrays = {"/".join("g" * MOST_NESTED): np.zeros(3), "wide": np.array(["a"], "U100000"), "é": np.zeros(2)}
    path = write_artifact(tmp_path / "x.checkpoint.h5", "checkpoint", arrays, **PROVENANCE)
    assert read_artifact(path)["wide"].dtype == "U100000"


def test_files_of_the_past_have_this_layout():
    paths = [*FIXTURES.rglob("*.h5"), *(FIXTURES.parents[1] / "results").glob("*.h5")]
    assert len(paths) > 10
    for path in paths:
        if "specimen" not in path.name:
            read_artifact(path)


LOCKED = """
import sys
import h5py
from artifacts import ArtifactError, read_artifact
try:
    read_artifact(sys.argv[1])
except ArtifactError as error:
    print(error)
"""


def test_a_locked_file_is_not_called_damaged(demos, monkeypatch):
    monkeypatch.setenv("HDF5_USE_FILE_LOCKING", "TRUE")
    with h5py.File(demos, "r+", locking=True):
        run = subprocess.run([sys.executable, "-c", LOCKED, str(demos)], capture_output=True, text=True, check=False)
    assert f"{demos} is locked by another program" in run.stdout, run.stderr


def test_too_little_memory_is_not_called_damage(demos, monkeypatch):
    def exhausted(*_):
        raise MemoryError

    artifact = read_artifact(demos)
    monkeypatch.setattr("artifacts.hdf5.read_dataset", exhausted)
    with pytest.raises(PlatformError, match=r"x\.demos\.h5 needs more memory"):
        artifact.read("frames")
