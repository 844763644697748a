"""robomimic's and Minari's HDF5 as they come, and files that only look like them."""

from __future__ import annotations

import json
import os

import h5py
import numpy as np
import pytest

from artifacts import read_artifact, write_artifact
from tests.stages.datasets.foreign import SIZE, number, robomimic, shown

MIDDLES = [[0, 4, 8], [0, 2, 4], [0, 3, 6]]  # three frames at equal times
EXPECTED = [[number(episode, frame) for frame in frames] for episode, frames in enumerate(MIDDLES)]


@pytest.fixture
def file(tmp_path):
    return robomimic(tmp_path / "demo.hdf5")


def test_robomimic(ifo, numbers, file):
    code, result, said = ifo(file)
    assert code == 0 and numbers(result["path"]) == EXPECTED, said
    demos = read_artifact(result["path"])
    np.testing.assert_allclose(demos["times"], np.array(MIDDLES) / 20)  # control_freq
    assert [record["name"] for record in demos.config["videos"]] == [f"{file}, demo_{k}" for k in range(3)]
    assert {record["camera"] for record in demos.config["videos"]} == {"agentview_image"}
    assert "not recorded" not in said


def test_demonstrations_are_in_natural_order(ifo, numbers, tmp_path):
    _, result, _ = ifo(robomimic(tmp_path / "demo.h5", [3] * 12))
    assert [video[0] for video in numbers(result["path"])] == [number(k, 0) for k in range(12)]


@pytest.mark.parametrize("camera", ["agentview", "agentview_image"])
def test_cameras_go_by_their_names_with_or_without_image(ifo, numbers, tmp_path, camera):
    path = robomimic(tmp_path / "demo.hdf5", cameras=("agentview_image", "robot0_eye_in_hand_image"))
    assert numbers(ifo(path, "--camera", camera)[1]["path"]) == EXPECTED
    code, _, said = ifo(path)
    assert code == 2 and "agentview_image, robot0_eye_in_hand_image" in said and said.count("\n") == 1


@pytest.mark.parametrize(
    ("made", "first"),
    [
        (lambda frames: frames.transpose(0, 3, 1, 2), 0),
        (lambda frames: np.concatenate([frames, frames[..., :1]], axis=-1), 0),
        (lambda frames: frames[..., :1], None),
    ],
)
def test_channels_lie_first_or_last(ifo, numbers, file, made, first):
    with h5py.File(file, "r+") as data:
        for demo in data["data"].values():
            frames = demo["obs/agentview_image"][...]
            del demo["obs/agentview_image"]
            demo["obs/agentview_image"] = made(frames)
    code, result, said = ifo(file)
    assert code == 0, said
    assert first is None or numbers(result["path"]) == EXPECTED
    assert first is not None or np.ptp(read_artifact(result["path"])["frames"].astype(int), axis=-1).max() == 0


def test_frame_rates_that_nobody_recorded(ifo, file):
    with h5py.File(file, "r+") as data:
        data["data"].attrs["env_args"] = json.dumps({"env_kwargs": None})
    code, result, said = ifo(file)
    assert code == 0 and "25 frames per second are assumed (3 of 3" in said
    assert read_artifact(result["path"])["times"][0, -1] == pytest.approx(8 / 25)


def truncate(file, data):
    size = file.stat().st_size
    data.close()
    os.truncate(file, size // 2)


def elsewhere(file, data):
    with h5py.File(file.with_name("other.h5"), "w") as other:
        other["secret"] = np.zeros((9, *SIZE, 3), np.uint8)


def link(data, to):
    del data["data/demo_0/obs/agentview_image"]
    data["data/demo_0/obs/agentview_image"] = to


def external(file, data):
    elsewhere(file, data)
    link(data, h5py.ExternalLink("other.h5", "secret"))


def virtual(file, data):
    elsewhere(file, data)
    layout = h5py.VirtualLayout((9, *SIZE, 3), np.uint8)
    layout[:] = h5py.VirtualSource(file.with_name("other.h5"), "secret", shape=layout.shape)
    del data["data/demo_0/obs/agentview_image"]
    data["data/demo_0/obs"].create_virtual_dataset("agentview_image", layout)


def raw(file, data):
    file.with_name("raw.bin").write_bytes(bytes(9 * SIZE[0] * SIZE[1] * 3))
    del data["data/demo_0/obs/agentview_image"]
    outside = [(str(file.with_name("raw.bin")), 0, h5py.h5f.UNLIMITED)]
    data["data/demo_0/obs"].create_dataset("agentview_image", (9, *SIZE, 3), np.uint8, external=outside)


def pictures_gone(file, data):
    del data["data/demo_0/obs/agentview_image"]


def shorter(file, data):
    data["data/demo_0"].attrs["num_samples"] = 40
    del data["data/demo_0/actions"]
    data["data/demo_0/actions"] = np.zeros((40, 7))


WHOLE = {
    "truncated": (truncate, "is truncated or damaged"),
    "external link": (external, "is a link, and links are not followed"),
    "soft link": (lambda file, data: link(data, h5py.SoftLink("/data/demo_1/obs/agentview_image")), "is a link"),
    "virtual": (virtual, "is stored in another file, which is not read"),
    "raw file": (raw, "is stored in another file, which is not read"),
    "no pictures": (
        lambda file, data: [demo.__delitem__("obs/agentview_image") for demo in data["data"].values()],
        "contains no images",
    ),
    "no demos": (lambda file, data: data.__delitem__("data"), "is HDF5 with an unknown layout"),
}
PARTS = {
    "pictures gone": (pictures_gone, "is missing or contains no images"),
    "short": (shorter, "is truncated to 9 of 40 frames"),
}


@pytest.mark.parametrize("fault", WHOLE)
def test_a_bad_file_is_one_line(ifo, file, tmp_path, fault):
    harm, words = WHOLE[fault]
    with h5py.File(file, "r+") as data:
        harm(file, data)
    code, printed, said = ifo(file)
    assert (code, printed) == (3, None) and said.count("\n") == 2 and words in said, said
    assert ifo(file, "--strict")[0] == 3 and not (tmp_path / "out").exists()


@pytest.mark.parametrize("fault", PARTS)
def test_bad_demonstrations_are_left_out(ifo, numbers, file, fault):
    harm, words = PARTS[fault]
    with h5py.File(file, "r+") as data:
        harm(file, data)
    code, result, said = ifo(file)
    assert code == 0 and words in said and "skipped 1" in said
    assert numbers(result["path"]) == EXPECTED[1:]


def test_damage_that_shows_when_frames_are_read(ifo, file):
    with h5py.File(file, "r+") as data:
        at = data["data/demo_0/obs/agentview_image"].id.get_chunk_info(0)
    content = bytearray(file.read_bytes())
    content[at.byte_offset : at.byte_offset + at.size] = bytes(at.size)
    file.write_bytes(content)
    code, _, said = ifo(file)
    assert code == 0 and f"skipped {file}, demo_0: its data is damaged" in said and "skipped 1" in said


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"text", "is not an HDF5 file"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
    ],
)
def test_files_that_are_no_hdf5(ifo, tmp_path, content, words):
    (tmp_path / "x.hdf5").write_bytes(content)
    code, _, said = ifo(tmp_path / "x.hdf5")
    assert code == 3 and words in said and said.count("\n") == 2


def test_an_artifact_is_no_data_set(ifo, tmp_path):
    path = tmp_path / "x.demos.h5"
    write_artifact(path, "demos", {"frames": np.zeros((1, 2, 16, 16, 3), np.uint8)}, config={}, seed=0, command="x")
    code, _, said = ifo(path)
    assert code == 3 and "is already an ifo artifact" in said


@pytest.fixture
def minari_set(tmp_path):
    """A function that has Minari write a data set: its folder."""
    pytest.importorskip("minari")
    import gymnasium
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    pixels = gymnasium.spaces.Box(0, 255, (*SIZE, 3), np.uint8)
    action = gymnasium.spaces.Box(-1, 1, (2,))

    def write(nested, **settings):
        space = gymnasium.spaces.Dict({"camera": gymnasium.spaces.Dict({"top": pixels})}) if nested else pixels
        folder = tmp_path / "set-v0" / "data"
        folder.mkdir(parents=True)
        storage = MinariStorage.new(folder, space, action, **settings)
        for episode, length in enumerate((9, 5, 7)):
            frames = [shown(episode, k) for k in range(length)]
            plain = np.zeros(length - 1)
            storage.update_episodes(
                [
                    EpisodeBuffer(
                        observations={"camera": {"top": frames}} if nested else frames,
                        actions=[np.zeros(2, np.float32)] * (length - 1),
                        rewards=list(plain),
                        terminations=list(plain.astype(bool)),
                        truncations=list(plain.astype(bool)),
                        infos={"time": list(np.arange(length) / 5)},
                    )
                ]
            )
        storage.update_metadata({"dataset_id": "set-v0", "minari_version": "0.5.4"})
        return folder.parent

    return write


@pytest.mark.parametrize("jpeg_encoding", [False, True])
@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize("named", ["", "data", "data/main_data.hdf5"])
def test_minari(ifo, numbers, minari_set, jpeg_encoding, nested, named):
    folder = minari_set(nested, jpeg_encoding=jpeg_encoding)
    code, result, said = ifo(folder / named, *(["--camera", "top"] if nested else []))
    assert code == 0 and numbers(result["path"]) == EXPECTED, said
    np.testing.assert_allclose(read_artifact(result["path"])["times"], np.array(MIDDLES) / 5)


def test_minari_stored_as_arrow_is_one_line(ifo, minari_set):
    folder = minari_set(False, data_format="arrow")
    code, _, said = ifo(folder)
    assert code == 3 and "stored as Arrow: expected HDF5" in said and said.count("\n") == 2
