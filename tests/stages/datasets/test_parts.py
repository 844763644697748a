"""Parts that readers of data sets share: names of cameras, times, pictures, windows of videos, statistics."""

import hashlib
import os
import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from artifacts import ArtifactError, UsageError, image_size
from stages.datasets.episode import Episode, brief, check_is_there, choose_camera, episodes_in, listing
from stages.datasets.feature_statistics import levels_in, of_numbers, of_pictures
from stages.datasets.frames import StoredFrames, as_picture, from_bytes, times_of
from stages.datasets.window import between, nearest, slack

CAMERAS = ["observation.images.front", "observation.images.side", "wrist_image"]


@pytest.mark.parametrize(
    ("wanted", "camera"),
    [
        ("observation.images.front", CAMERAS[0]),
        ("front", CAMERAS[0]),
        ("side", CAMERAS[1]),
        ("wrist_image", CAMERAS[2]),
        ("wrist", CAMERAS[2]),
    ],
)
def test_a_camera_is_named_in_full_or_by_its_last_part(tmp_path, wanted, camera):
    assert choose_camera(tmp_path, CAMERAS, wanted) == camera


def test_an_only_camera_need_not_be_named(tmp_path):
    assert choose_camera(tmp_path, CAMERAS[:1], "") == CAMERAS[0]
    exact = ["a/front", "front"]
    assert choose_camera(tmp_path, exact, "front") == "front", "a full name comes before a last part"


@pytest.mark.parametrize(
    ("cameras", "wanted", "kind", "message"),
    [
        ([], "", ArtifactError, "contains no images"),
        ([], "front", ArtifactError, "contains no images"),
        (CAMERAS, "", UsageError, r"has the cameras observation\.images\.front, .*: choose one with --camera"),
        (CAMERAS, "top", UsageError, r"--camera top: .* has no such camera: expected observation\.images\.front, "),
        (["a/front", "b/front"], "front", UsageError, "--camera front"),
    ],
)
def test_a_camera_that_cannot_be_told_is_refused(tmp_path, cameras, wanted, kind, message):
    with pytest.raises(kind, match=message) as caught:
        choose_camera(tmp_path, cameras, wanted)
    assert str(tmp_path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("wanted", "camera"),
    [
        ("agentview", "obs/agentview_rgb"),
        ("agentview_rgb", "obs/agentview_rgb"),
        ("eye", "eye.image"),
        ("images.top", "observation.images.top"),
        ("left", "left_image"),
        ("left_img", "x/left_img"),
    ],
)
def test_endings_of_names_may_be_left_out(tmp_path, wanted, camera):
    cameras = ["obs/agentview_rgb", "eye.image", "observation.images.top", "left_image", "x/left_img"]
    if wanted == "left":
        cameras.pop()
    assert choose_camera(tmp_path, cameras, wanted) == camera


def test_candidates_of_an_ambiguous_name_are_listed(tmp_path):
    cameras = ["agentview_image", "agentview_rgb", "wrist_rgb"]
    with pytest.raises(UsageError, match="has the cameras agentview_image, agentview_rgb: give the full name"):
        choose_camera(tmp_path, cameras, "agentview")


def test_texts_of_files_fit_in_a_message():
    assert brief("\x1b[2Jé\n x\0") == "\\x1b[2Jé x\\x00"
    assert len(brief("x" * 10**6)) < 100
    assert listing([f"c{k}" for k in range(25)]).endswith("c19 and 5 more")


def test_an_episode_is_known_by_name_camera_and_files(tmp_path):
    files = [tmp_path / name for name in ("a", "b")]
    for file in files:
        file.write_text(file.name * 9)

    def digest(part, camera, *inside):
        return Episode(tmp_path, part=part, camera=camera, inside=inside).sha256()

    lines = ["episode 3\0front", *(hashlib.sha256(file.read_bytes()).hexdigest() for file in files)]
    assert (
        digest("episode 3", "front", *files)
        == hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()
    )
    all_of_them = {
        digest("episode 3", "front", *files),
        digest("episode 4", "front", *files),
        digest("episode 3", "side", *files),
        digest("episode 3", "front", *files[::-1]),
        digest("episode 3", "front", files[0]),
    }
    assert len(all_of_them) == 5


def test_episodes_of_one_file_read_it_once_and_open_themselves(tmp_path, monkeypatch):
    file = tmp_path / "x.hdf5"
    file.write_bytes(b"data")
    opened = []
    episodes = episodes_in(file, tmp_path, "front", ["demo_0", "demo_1"], lambda name: opened.append(name) or name)
    assert [episode.part for episode in episodes] == ["demo_0", "demo_1"]
    assert all(each.camera == "front" and each.path == tmp_path and each.files == (file,) for each in episodes)
    assert [episode.open() for episode in episodes] == opened == ["demo_0", "demo_1"]
    read = []
    monkeypatch.setattr("stages.datasets.episode.sha256_of", lambda path: read.append(path) or "0" * 64)
    assert episodes[0].sha256() != episodes[1].sha256()
    assert read == [file]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file: download the whole dataset"),
        (b"", "is empty"),
        (b"version https://git-lfs.github.com/spec/v1\n", "is a Git LFS pointer .*git lfs pull"),
    ],
)
def test_files_that_were_not_downloaded_are_told(tmp_path, content, message):
    path = tmp_path / "x.parquet"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ArtifactError, match=message):
        check_is_there(path)
    path.write_bytes(b"version 2")
    check_is_there(path)
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "endless").symlink_to("/dev/zero")
    for other in (tmp_path, tmp_path / "pipe", tmp_path / "endless", tmp_path / ("x" * 5000)):
        with pytest.raises(ArtifactError, match="cannot be read"):
            check_is_there(other)


REPLACED = "time stamps that do not increase from frame to frame are replaced by equal steps"


@pytest.mark.parametrize(
    ("stamps", "rate", "times", "notes"),
    [
        (np.array([0.5, 0.7, 1.5]), 10, [0.5, 0.7, 1.5], []),
        (np.array([1, 2, 4]), 0, [1.0, 2.0, 4.0], []),
        (np.array([1, 2, 4], np.uint8), 0, [1.0, 2.0, 4.0], []),
        (None, 10, [0.0, 0.1, 0.2], []),
        (None, 0, [0.0, 0.04, 0.08], ["unknown"]),
        (None, 1e300, [0.0, 0.04, 0.08], ["unknown"]),
        (None, 1e-300, [0.0, 0.04, 0.08], ["unknown"]),
        (np.array([0.0, 0.5]), 10, [0.0, 0.1, 0.2], [REPLACED]),
        (np.array([[0.0, 0.5, 0.7]]), 10, [0.0, 0.1, 0.2], [REPLACED]),
        (np.array([0.0, 0.5, 0.5]), 10, [0.0, 0.1, 0.2], [REPLACED]),
        (np.array([0.0, 0.5, np.inf]), 10, [0.0, 0.1, 0.2], [REPLACED]),
        (np.array([-1e308, 0.0, 1e308]), 10, [0.0, 0.1, 0.2], [REPLACED]),
        (np.array([0.0, 0.5, np.nan]), 0, [0.0, 0.04, 0.08], [REPLACED, "unknown"]),
        (np.array([b"a", b"b", b"c"]), 10, [0.0, 0.1, 0.2], [REPLACED]),
    ],
)
def test_times_are_the_files_where_they_are_usable(stamps, rate, times, notes):
    found, said = times_of(stamps, 3, rate, "unknown")
    np.testing.assert_allclose(found, times)
    assert said == notes and found.dtype == np.float64


def test_stored_pictures_are_footage():
    frames = np.random.default_rng(0).integers(0, 256, (4, 20, 30, 3), dtype=np.uint8)
    stored = StoredFrames("x, demo_0", np.array([2.0, 2.1, 2.4, 3.0]), lambda at: iter(frames[at]), "is cut", ["told"])
    np.testing.assert_allclose(stored.times, [0.0, 0.1, 0.4, 1.0])
    assert stored.duration == pytest.approx(1.3), "the last frame lasts as long as the others usually do"
    assert (stored.label, stored.cut, stored.rotation, stored.notes) == ("x, demo_0", "is cut", 0, ["told"])
    shown = list(stored.pictures(np.array([1, 3])))
    assert [time for time, _ in shown] == pytest.approx([0.1, 1.0])
    np.testing.assert_array_equal([picture for _, picture in shown], frames[[1, 3]])
    single, none = (StoredFrames("x", times, None) for times in (np.array([3.0]), np.empty(0)))
    assert (single.duration, none.duration) == (0.0, 0.0) and single.times.tolist() == [0.0] and not len(none.times)


def test_stored_pictures_of_an_absurd_size_are_refused():
    stored = StoredFrames("x, demo_0", np.arange(2.0), lambda at: iter([np.zeros((20, 9, 3), np.uint8)]))
    with pytest.raises(ArtifactError, match=r"x, demo_0: its image has 9x20 pixels"):
        list(stored.pictures(np.array([0])))


@pytest.mark.parametrize("shape", [(20, 30, 3), (20, 30, 1), (20, 30, 4), (3, 20, 30), (1, 20, 30), (3, 30, 3)])
def test_channels_may_lie_last_or_first(shape):
    array = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    picture = as_picture("x", array)
    assert picture.shape == (3 if shape == (3, 30, 3) else 20, 30, 3)
    last = array if shape[2] < 5 else np.moveaxis(array, 0, -1)
    for channel in range(3):
        np.testing.assert_array_equal(picture[..., channel], last[..., channel if last.shape[2] > 1 else 0])


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((20, 30), np.uint8),
        np.zeros((20, 30, 3), np.float32),
        np.zeros((20, 30, 2), np.uint8),
        np.zeros((4, 20, 30), np.uint8),
    ],
)
def test_what_is_no_picture_is_refused(array):
    with pytest.raises(
        ArtifactError, match=r"x, 3: a frame is (uint8|float32) \(.*expected uint8 \(height, width, 3\)"
    ):
        as_picture("x, 3", array)


def test_pictures_in_bytes_are_decoded():
    frame = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    data = cv2.imencode(".png", frame[..., ::-1])[1].tobytes()
    np.testing.assert_array_equal(from_bytes("x", data), frame)
    for broken in (None, b"", b"text", data[:50]):
        with pytest.raises(ArtifactError, match="x, 3: a frame is not a complete PNG or JPEG"):
            from_bytes("x, 3", broken)


def png_header(width, height):
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", width, height) + bytes(50) + b"IEND"


def test_sizes_are_checked_before_pictures_are_decoded():
    for width, height in ((30, 20), (300, 200)):
        frame = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
        for suffix in (".png", ".jpg"):
            assert image_size(cv2.imencode(suffix, frame)[1].tobytes()) == (width, height)
    for data in (b"", b"\x89PNG", b"\xff\xd8", b"\xff\xd8" + bytes(99), b"\xff\xd8" + b"\xff" * 99, b"GIF89a"):
        assert image_size(data) is None
    for width, height in ((30000, 30000), (65535, 65535), (2**31, 2**31), (0, 20), (16000, 16000)):
        with pytest.raises(ArtifactError, match=f"x, 3: its image has {width}x{height} pixels"):
            from_bytes("x, 3", png_header(width, height))


def window(begin, end, length=0, frames=60, begins=0.0, notes=()):
    """A window of a video of ten frames a second; each picture is its index."""
    video = SimpleNamespace(
        label="file.mp4", begins=begins, duration=0.1, times=np.arange(frames) / 10, rotation=90, notes=["of the file"],
        pictures=lambda indices: ((index / 10, index) for index in indices),
    )  # fmt: skip
    return between("file.mp4, episode 2", video, begin, end, length, notes)


@pytest.mark.parametrize(
    ("begin", "end", "length", "begins", "first", "count"),
    [
        (0.0, 6.0, 60, 0.0, 0, 60),
        (1.0, 2.0, 10, 0.0, 10, 10),
        (1.0, 2.0, 0, 0.0, 10, 10),
        (1.04, 2.04, 10, 0.0, 10, 10),
        (0.96, 1.96, 10, 0.0, 10, 10),
        (1.0, 2.04, 10, 0.0, 10, 10),
        (1.5, 2.5, 10, 0.5, 10, 10),
    ],
)
def test_a_window_begins_at_the_nearest_frame_and_has_its_length(begin, end, length, begins, first, count):
    found = window(begin, end, length, begins=begins)
    assert [picture for _, picture in found.pictures(np.arange(count))] == list(range(first, first + count))
    np.testing.assert_allclose(found.times, np.arange(count) / 10)
    assert found.duration == pytest.approx(count / 10)
    assert [time for time, _ in found.pictures(np.array([0, 3]))] == pytest.approx([0.0, 0.3])
    assert found.cut == "" and found.rotation == 90


def test_notes_of_a_window_are_its_own_and_the_files():
    assert window(0.0, 1.0, notes=["own"]).notes == ["own", "of the file"]
    short = "videos are one or two frames shorter than their tables state"
    assert window(5.5, 6.2, 7).notes == [short, "of the file"]
    assert window(5.5, 6.2, 7).cut == "" and len(window(5.5, 6.2, 7).times) == 5


def test_a_window_beyond_the_file_is_cut_or_refused():
    assert window(5.5, 7.5, 20).cut == "is truncated to 5 of 20 frames"
    assert window(5.5, 7.5).cut == "is truncated to 5 of 20 frames"
    assert window(0.0, 6.3, 63).cut == "is truncated to 60 of 63 frames"
    assert window(0.0, 30.2, 302, frames=300).cut == "" and window(0.0, 30.6, 306, frames=300).cut == ""
    assert window(0.0, 30.7, 307, frames=300).cut != "", "of many frames one in fifty may be missing"
    with pytest.raises(ArtifactError, match=r"file\.mp4: ends at 6\.00 s, before file\.mp4, episode 2"):
        window(6.0, 7.0)


@pytest.mark.parametrize(("begin", "end", "length"), [(2.0, 2.0, 0), (2.0, 1.0, 10), (1.0, 2.0, 11), (1.0, 2.0, 9)])
def test_tables_that_contradict_themselves_are_refused(begin, end, length):
    with pytest.raises(ArtifactError, match=rf"episode 2: spans {begin:g} to {end:g} s but has {length} frames"):
        window(begin, end, length)


def test_a_file_of_one_frame_is_a_window():
    single = window(0.0, 0.1, 1, frames=1)
    assert single.times.tolist() == [0.0] and single.duration == pytest.approx(0.1)


@pytest.mark.parametrize(("length", "frames"), [(10, 2), (100, 2), (150, 3), (1000, 20)])
def test_a_length_may_be_off_by_two_frames_or_one_in_fifty(length, frames):
    assert slack(length) == frames


def test_statistics_of_numbers_are_numpys():
    values = np.random.default_rng(0).normal(size=37)
    found = of_numbers(values)
    assert found["count"] == [37]
    expected = {"min": values.min(), "max": values.max(), "mean": values.mean(), "std": values.std()}
    expected |= {f"q{q:02d}": np.percentile(values, q) for q in (1, 10, 50, 90, 99)}
    assert set(found) == {"count", *expected}
    for name, value in expected.items():
        assert found[name] == [pytest.approx(value)] and type(found[name][0]) is float
    assert of_numbers(np.array([1, 2]))["mean"] == [1.5]


def test_statistics_of_pictures_are_numpys():
    frames = np.random.default_rng(0).integers(10, 250, (5, 8, 9, 3)).astype(np.uint8)
    frames[..., 1] //= 3
    counts = levels_in(frames)
    assert counts.shape == (3, 256)
    np.testing.assert_array_equal(counts[1], [(frames[..., 1] == level).sum() for level in range(256)])
    found, pixels = of_pictures(counts, 5), frames.reshape(-1, 3) / 255
    assert found["count"] == [5]
    expected = {
        "min": pixels.min(axis=0),
        "max": pixels.max(axis=0),
        "mean": pixels.mean(axis=0),
        "std": pixels.std(axis=0),
    }
    expected |= {f"q{q:02d}": np.percentile(pixels, q, axis=0, method="inverted_cdf") for q in (1, 10, 50, 90, 99)}
    assert set(found) == {"count", *expected}
    for name, values in expected.items():
        assert np.shape(found[name]) == (3, 1, 1)
        np.testing.assert_allclose(np.ravel(found[name]), values, atol=1e-9, err_msg=name)
    flat = of_pictures(levels_in(np.full((2, 4, 4, 3), 255, np.uint8)), 2)
    assert np.ravel(flat["std"]).tolist() == [0, 0, 0] and np.ravel(flat["max"]).tolist() == [1, 1, 1]
    assert np.ravel(flat["min"]).tolist() == [1, 1, 1]


@pytest.mark.parametrize(
    ("time", "expected"),
    [(0.1, 2), (0.46, 9), (-0.2, -4), (float("nan"), -1), (float("inf"), -1), (1e308, -1), (-1e308, -1), (1.7e308, -1)],
)
def test_a_time_that_no_number_of_frames_reaches_is_none(time, expected):
    video = SimpleNamespace(times=0.05 * np.arange(5), begins=0.0)
    assert nearest(video, time) == expected
