"""What counts as a video, how it is called, and by what it is known again."""

import hashlib

import cv2
import numpy as np
import pytest

from artifacts import ArtifactError
from stages.footage.images import ImageFolder, decoded
from stages.footage.sources import Source, find_videos, natural_order
from stages.footage.video import VideoFile
from tests.stages.videos import write_video


def picture(seed=0, size=(20, 30)):
    return np.random.default_rng(seed).integers(0, 256, (*size, 3), dtype=np.uint8)


def encoded(frame, suffix=".png"):
    return cv2.imencode(suffix, frame[..., ::-1])[1].tobytes()


@pytest.fixture
def folder(tmp_path):
    """Twelve images, named without leading zeros."""
    for k in range(12):
        (tmp_path / f"Shot{k}.PNG").write_bytes(encoded(picture(k)))
    (tmp_path / ".Shot3.png").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("x")
    return tmp_path


def test_images_of_a_folder_are_one_video_in_natural_order(folder):
    (source,) = find_videos(folder)
    assert source.path == folder and [image.name for image in source.images] == [f"Shot{k}.PNG" for k in range(12)]
    assert source.label == str(folder) and source.files == source.images
    opened = source.open()
    assert isinstance(opened, ImageFolder) and opened.label == str(folder)
    np.testing.assert_allclose(opened.times, np.arange(12) / 25)
    assert opened.duration == pytest.approx(12 / 25)
    assert (opened.cut, opened.rotation, opened.notes) == ("", 0, [])
    shown = list(opened.pictures(np.array([0, 2, 11])))
    assert [time for time, _ in shown] == [0.0, 0.08, 0.44]
    for (_, frame), k in zip(shown, (0, 2, 11), strict=True):
        np.testing.assert_array_equal(frame, picture(k))


def test_videos_of_a_folder_come_before_its_images(folder):
    for name in ("b.mp4", "A.MKV"):
        (folder / name).touch()
    assert [source.path.name for source in find_videos(folder)] == ["A.MKV", "b.mp4"]
    assert all(source.images == () for source in find_videos(folder))


@pytest.mark.parametrize(
    "suffix", ["mp4", "m4v", "mov", "avi", "webm", "mkv", "gif", "mpg", "mpeg", "ts", "mts", "3gp", "wmv"]
)
def test_suffixes_of_videos(tmp_path, suffix):
    (tmp_path / f"x.{suffix}").touch()
    assert len(find_videos(tmp_path)) == 1


@pytest.mark.parametrize("suffix", ["png", "jpg", "jpeg"])
def test_suffixes_of_images(tmp_path, suffix):
    (tmp_path / f"x.{suffix}").touch()
    assert find_videos(tmp_path)[0].images == (tmp_path / f"x.{suffix}",)


def test_a_file_is_a_video_whatever_it_is_called(tmp_path):
    path = write_video(tmp_path / "x.mp4").rename(tmp_path / "film")
    (source,) = find_videos(path)
    assert source == Source(path) and source.label == str(path) and source.files == (path,)
    assert isinstance(source.open(), VideoFile)
    assert source.sha256() == hashlib.sha256(path.read_bytes()).hexdigest()


def test_an_episode_is_called_by_its_data_set_and_its_own_name(tmp_path):
    assert Source(tmp_path / "set", part="episode 3", camera="front").label == f"{tmp_path / 'set'}, episode 3"


def test_a_folder_is_known_by_names_and_contents_of_its_images_in_order(folder):
    (source,) = find_videos(folder)
    lines = [f"{image.name}\0{hashlib.sha256(image.read_bytes()).hexdigest()}\n" for image in source.images]
    assert source.sha256() == hashlib.sha256("".join(lines).encode()).hexdigest()
    before = source.sha256()
    (folder / "Shot4.PNG").write_bytes(encoded(picture(99)))
    assert source.sha256() != before


def test_names_are_ordered_as_people_count(tmp_path):
    names = ["take10", "Take2", "take2", "take1b", "take01", "7", "a", "10"]
    ordered = [path.name for path in sorted(map(tmp_path.joinpath, names), key=natural_order)]
    assert ordered == ["7", "10", "a", "take01", "take1b", "Take2", "take2", "take10"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda at: at / "none", "none: no such file"),
        (lambda at: at, "contains no videos or images"),
        (lambda at: type(at)("/dev/null"), "is not a regular file"),
    ],
)
def test_what_is_neither_is_refused(tmp_path, make, message):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "x.mp4").touch()
    with pytest.raises(ArtifactError, match=message) as caught:
        find_videos(make(tmp_path))
    assert "\n" not in str(caught.value)


def test_a_link_to_nothing_is_said_where_it_is_opened(tmp_path):
    (tmp_path / "x.png").symlink_to(tmp_path / "gone.png")
    (source,) = find_videos(tmp_path)
    with pytest.raises(ArtifactError, match=r"x\.png: cannot be read \(No such file"):
        list(source.open().pictures(np.array([0])))


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_whole_images_are_decoded_and_truncated_ones_are_not(suffix):
    data = encoded(picture(size=(64, 64)), suffix)
    assert decoded(data).shape == (64, 64, 3)
    if suffix == ".png":
        np.testing.assert_array_equal(decoded(data), picture(size=(64, 64)))
    assert np.abs(decoded(data).mean(axis=(0, 1)) - picture(size=(64, 64)).mean(axis=(0, 1))).max() < 6
    np.testing.assert_array_equal(decoded(data + b"some more bytes"), decoded(data))
    assert decoded(data[: len(data) // 2]) is None
    assert decoded(data[:-2]) is None
    assert decoded(b"") is None and decoded(b"text" * 40) is None
    assert decoded(data[:40] + b"\0" * 40 + data[-12:]) is None


def test_an_image_that_is_none_is_named(folder):
    (folder / "Shot4.PNG").write_bytes(b"\x89PNG")
    opened = find_videos(folder)[0].open()
    with pytest.raises(ArtifactError, match=r"Shot4\.PNG: is not a complete PNG or JPEG"):
        list(opened.pictures(np.array([3, 4])))


def test_images_of_an_absurd_size_are_refused(folder):
    (folder / "Shot4.PNG").write_bytes(encoded(picture(size=(8, 40))))
    with pytest.raises(ArtifactError, match=r"Shot4\.PNG: its image has 40x8 pixels"):
        list(find_videos(folder)[0].open().pictures(np.array([4])))
