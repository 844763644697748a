"""HDF5 files of other programs whose content is not what it says: one line, no crash, no time or memory to speak of."""

from __future__ import annotations

import json
import os
import shutil
import struct
import zlib

import h5py
import numpy as np
import pytest

from artifacts import ArtifactError
from stages.datasets.finding import find_episodes
from stages.datasets.hdf5_chunks import StoredArray
from tests.stages.datasets.foreign import SIZE, number, robomimic
from tests.stages.videos import number_in

LENGTHS = (9, 5, 7)
TRUE = [[number(episode, frame) for frame in range(length)] for episode, length in enumerate(LENGTHS)]
CAMERA = "data/demo_0/obs/agentview_image"
SHAPE = (9, *SIZE, 3)


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    return robomimic(tmp_path_factory.mktemp("made") / "demo.hdf5", LENGTHS)


@pytest.fixture
def edited(original, tmp_path):
    """A function that changes a file: what each episode shows, or the message that refuses it; and all remarks."""

    def edit(change, camera=""):
        path = shutil.copy(original, tmp_path / "demo.hdf5")
        with h5py.File(path, "r+") as file:
            change(file)
        return taken(path, camera)

    return edit


def taken(path, camera=""):
    found, notes = [], set()
    for episode in find_episodes(path, camera):
        try:
            footage = episode.open()
            pictures = footage.pictures(np.arange(len(footage.times)))
            found.append([number_in(picture[:, 8:56]) for _, picture in pictures])
            notes |= set(footage.notes)
        except ArtifactError as error:
            found.append(str(error))
    return found, " ".join(notes)


def png(width, height):
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", width, height) + bytes(50) + b"IEND"


def replace(file, shape=SHAPE, dtype=np.uint8, chunk=None, name=CAMERA, **settings):
    """Put another dataset at the place of a camera; each of its chunks holds these bytes."""
    del file[name]
    if chunk is not None:
        settings["chunks"] = (1, *shape[1:])
    made = file.create_dataset(name, shape, dtype, **settings)
    for k in range(shape[0] if chunk is not None else 0):
        made.id.write_direct_chunk((k, *[0] * (len(shape) - 1)), chunk)


def encoded(file, width, height):
    data = np.frombuffer(png(width, height), np.uint8)
    del file[CAMERA]
    file[CAMERA] = np.tile(data, (9, 1))


def variable(file):
    del file[CAMERA]
    made = file.create_dataset(CAMERA, (9,), h5py.vlen_dtype(np.uint8))
    made[0] = np.frombuffer(png(65535, 65535), np.uint8)


SIZES = (1, *SIZE, 3)
EMPTY_LZF = b"\x01ab"
BAD = {
    "fletcher32": (lambda file: replace(file, chunk=b"ab", fletcher32=True), "a chunk has the wrong size"),
    "shuffle": (lambda file: replace(file, chunk=b"abc", shuffle=True), "a chunk has the wrong size"),
    "plain": (lambda file: replace(file, chunk=b"abc"), "a chunk has the wrong size"),
    "gzip": (lambda file: replace(file, chunk=zlib.compress(b"ab"), compression="gzip"), "has the wrong size"),
    "gzip, too long": (
        lambda file: replace(file, chunk=zlib.compress(bytes(10**7)), compression="gzip"),
        "has the wrong size",
    ),
    "lzf": (lambda file: replace(file, chunk=EMPTY_LZF, compression="lzf"), "has the wrong size"),
    "gzip and fletcher32": (
        lambda file: replace(file, chunk=b"abcd", compression="gzip", fletcher32=True),
        "has the wrong size",
    ),
    "another filter": (
        lambda file: replace(file, chunk=b"ab", scaleoffset=4),
        "not supported: repack it with h5repack",
    ),
    "nothing stored": (lambda file: replace(file, chunks=SIZES), "its data is incomplete"),
    "nothing stored in one piece": (lambda file: replace(file), "its data is incomplete"),
    "huge": (lambda file: replace(file, (10**12, 2**14, 2**14, 3), chunks=(1, 1, 2**14, 3)), "its data is incomplete"),
    "huge in one piece": (lambda file: replace(file, (10**9, *SIZE, 3)), "its data is incomplete"),
    "large frames": (lambda file: replace(file, (2, 20000, 20000, 3), chunks=(1, 64, 20000, 3)), "is incomplete"),
    "a huge chunk": (lambda file: replace(file, (2, 20000, 20000, 3), chunks=(2, 20000, 20000, 3)), "not supported"),
    "bytes of nothing": (lambda file: replace(file, (9, 2**40)), "its data is incomplete"),
    "30000x30000": (lambda file: encoded(file, 30000, 30000), "its image has 30000x30000 pixels"),
    "65535x65535": (lambda file: encoded(file, 65535, 65535), "its image has 65535x65535 pixels"),
    "of variable length": (variable, "its image has 65535x65535 pixels"),
    "a text": (lambda file: replace(file, (), h5py.string_dtype()), "contains no images"),
    "empty": (lambda file: (file.__delitem__(CAMERA), file.__setitem__(CAMERA, h5py.Empty("f"))), "no images"),
    "a type": (lambda file: (file.__delitem__(CAMERA), file.__setitem__(CAMERA, np.dtype("f8"))), "no images"),
    "a group": (lambda file: (file.__delitem__(CAMERA), file.create_group(CAMERA)), "no images"),
    "no frames": (lambda file: replace(file, (0, *SIZE, 3)), "has no frames"),
}


@pytest.mark.parametrize("fault", BAD)
def test_only_the_bad_demonstration_is_refused(edited, fault):
    change, words = BAD[fault]
    found, _ = edited(change)
    assert words in found[0] and found[1:] == TRUE[1:]
    assert "\n" not in found[0]


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"compression": "lzf"},
        {"compression": "lzf", "shuffle": True},
        {"compression": "gzip", "fletcher32": True, "shuffle": True},
        {"fletcher32": True},
        {"chunks": (4, 20, 64, 1), "compression": "gzip"},
        {"chunks": (4, 20, 64, 1), "fletcher32": True},
        {"chunks": (9, *SIZE, 3), "compression": "lzf"},
    ],
)
def test_every_common_way_of_storing_is_read(edited, settings):
    def change(file):
        frames = file[CAMERA][...]
        del file[CAMERA]
        file.create_dataset(CAMERA, data=frames, **settings)

    assert edited(change) == (TRUE, "")


def test_chunks_that_a_filter_skipped(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (3, 20, 20, 3), dtype=np.uint8)
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file.create_dataset("x", data=noise, compression="lzf", chunks=(1, 20, 20, 3))
        assert file["x"].id.get_chunk_info(0).filter_mask, "LZF leaves noise as it is"
        array = StoredArray("x", file["x"])
        np.testing.assert_array_equal([array[k] for k in range(3)], noise)


ATTRIBUTES = [
    "nine", b"9", float("nan"), 1e300, -4, 2**70 * 1.0, h5py.Empty("f"), np.zeros((3, 3)), np.zeros(0), "9" * 5000,
    np.array([(1, 2.0)], dtype=[("a", int), ("b", float)]), h5py.Reference(), True, np.array([9]),
]  # fmt: skip


@pytest.mark.parametrize("value", ATTRIBUTES, ids=lambda value: type(value).__name__)
def test_attributes_of_any_type(edited, value):
    def change(file):
        dtype = h5py.ref_dtype if isinstance(value, h5py.Reference) else None
        file["data"].attrs.create("env_args", value, dtype=dtype)
        file["data/demo_0"].attrs.create("num_samples", value, dtype=dtype)

    found, notes = edited(change)
    assert found == TRUE and "25 frames per second are assumed" in notes


@pytest.mark.parametrize("text", ["[" * 100000, "{}", '{"env_kwargs": {"control_freq": 1e400}}', "x" * 2**21, "null"])
def test_arguments_that_are_no_arguments(edited, text):
    assert edited(lambda file: file["data"].attrs.create("env_args", text, dtype=None))[0] == TRUE


@pytest.mark.parametrize(
    "times",
    [np.full(9, np.nan), np.full(9, np.inf), np.arange(9)[::-1], np.arange(5.0), np.zeros((9, 2)), [b"x"] * 9],
    ids=["NaN", "infinity", "backward", "short", "two axes", "text"],
)
def test_times_that_are_no_times(edited, times):
    found, notes = edited(lambda file: file.__setitem__("data/demo_0/times", times))
    assert found == TRUE and "are replaced by equal steps" in notes


def test_numbers_that_are_not_finite_elsewhere_do_not_matter(edited):
    def change(file):
        file["data/demo_0/actions"][...] = np.nan
        file["data/demo_0/states"] = np.full((9, 3), np.inf)

    assert edited(change) == (TRUE, "")


def test_a_wrong_number_of_samples_is_told(edited):
    found, notes = edited(lambda file: file["data/demo_0"].attrs.__setitem__("num_samples", 40))
    assert found == TRUE and "differs from what the file states elsewhere" in notes


def test_groups_within_themselves(edited):
    def change(file):
        observed = file["data/demo_0/obs"]
        for k in range(20):
            observed[f"again_{k}"] = observed
            observed[f"up_{k}"] = file

    assert edited(change, "agentview_image")[0] == TRUE


def test_groups_of_great_depth(edited):
    def change(file):
        group = file["data/demo_0/obs"]
        for _ in range(2000):
            group = group.create_group("g")
        group["deep"] = np.zeros((2, 20, 20, 3), np.uint8)

    assert edited(change) == (TRUE, "")


@pytest.mark.parametrize("offset", [16, 40])
def test_heaps_without_an_end(original, tmp_path, offset):
    """HDF5 never returns from a heap with zeros in it."""
    path = shutil.copy(original, tmp_path / "demo.hdf5")
    content = bytearray(original.read_bytes())
    at = content.index(b"GCOL") + offset
    content[at : at + 512] = bytes(512)
    path.write_bytes(content)
    with pytest.raises(ArtifactError, match="a heap without an end"):
        taken(path)


@pytest.mark.parametrize(
    ("error", "words"), [(BlockingIOError, "is locked by another program"), (MemoryError, "does not fit in memory")]
)
def test_not_every_file_that_cannot_be_read_is_damaged(original, monkeypatch, error, words):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(h5py, "File", fail)
    with pytest.raises(ArtifactError, match=words):
        find_episodes(original, "")


def test_links_in_a_circle(edited):
    def change(file):
        file["data/demo_0/obs/a"] = h5py.SoftLink("/data/demo_0/obs/b")
        file["data/demo_0/obs/b"] = h5py.SoftLink("/data/demo_0/obs/a")

    with pytest.raises(ArtifactError, match="is a link, and links are not followed"):
        edited(change)


@pytest.mark.parametrize("name", ["demo\n1", "\x1b[2J", "x" * 5000])
def test_names_that_cannot_be_printed_are_left_out(edited, name):
    assert edited(lambda file: file["data"].move("demo_1", name))[0] == [TRUE[0], TRUE[2]]


@pytest.mark.parametrize("kind", ["pipe", "endless"])
def test_a_file_that_is_no_file(tmp_path, kind):
    folder = tmp_path / "set" / "data"
    folder.mkdir(parents=True)
    if kind == "pipe":
        os.mkfifo(folder / "main_data.hdf5")
    else:
        (folder / "main_data.hdf5").symlink_to("/dev/zero")
    assert find_episodes(tmp_path / "set", "") == []


@pytest.mark.parametrize("steps", ["x", -1, [], 4])
def test_minari_of_any_type(tmp_path, steps):
    with h5py.File(tmp_path / "main_data.hdf5", "w") as file:
        for k in range(2):
            file[f"episode_{k}/observations/top"] = np.zeros((4, 20, 20, 3), np.uint8)
            file[f"episode_{k}/infos/time"] = json.dumps({})
            file[f"episode_{k}"].attrs["total_steps"] = steps
        file["episode_2/observations"] = 3
        file["episode_3"] = 3
    found, _ = taken(tmp_path)
    cut = "is truncated"
    assert len(found) == 3 and "contains no images" in found[2]
    assert cut not in found[0]
