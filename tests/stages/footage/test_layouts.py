"""Whole files whose headers are wrong, damaged ones whose headers are right, and files with several tracks."""

from __future__ import annotations

from types import SimpleNamespace

import av
import numpy as np
import pytest

from artifacts import ArtifactError
from stages.footage.decoding import Damage
from stages.footage.video import VideoFile
from tests.faults.injections.inputs import DIFFERENT, decoder_complains
from tests.stages.videos import COUNT, FPS, damage, number_in, remux, write_avi, write_video

SQUARE = (48, 48)


def numbers(video, indices=None):
    """What the frames at these indices show; by default all frames."""
    indices = np.arange(len(video.times)) if indices is None else np.asarray(indices)
    return [number_in(frame) for _, frame in video.pictures(indices)]


@pytest.mark.parametrize("codec", ["mjpeg", "mpeg4"])
def test_dropped_frames_of_an_avi_keep_the_previous_one_on_display(codec, tmp_path):
    dropped = (7, 8, 15)
    video = VideoFile(write_avi(tmp_path / "x.avi", dropped, codec))
    shown = [k for k in range(COUNT) if k not in dropped]
    assert not video.cut and not video.damage
    np.testing.assert_allclose(video.times, np.array(shown) / FPS)
    assert numbers(video) == shown and not video.damage


def test_the_default_video_track_is_taken_and_named(tmp_path):
    small = write_video(tmp_path / "small.mp4", size=(32, 32), count=10)
    large = write_video(tmp_path / "large.mp4", size=SQUARE)
    for default, size in ((0, (32, 32)), (1, SQUARE)):
        path = remux(tmp_path / f"{default}.mkv", small, large, default=default)
        video = VideoFile(path)
        [(_, frame)] = video.pictures(np.array([3]))
        assert frame.shape[:2] == size and number_in(frame) == 3
        assert video.notes == [f"of 2 video tracks, number {default + 1} ({size[1]}x{size[0]}) is taken"]
    both = VideoFile(remux(tmp_path / "both.mkv", small, large, default=None))
    assert both.notes == ["of 2 video tracks, number 2 (48x48) is taken"]


@pytest.mark.parametrize(
    ("suffix", "codec", "options"),
    [
        ("mkv", "libx264", {"g": "10", "bf": "2", "sc_threshold": "0"}),
        ("ts", "libx264", {"g": "10", "bf": "0", "sc_threshold": "0"}),
        ("mkv", "mpeg4", {"g": "10"}),
        ("mkv", "libvpx", {"g": "10", "deadline": "realtime", "cpu-used": "8"}),
        ("avi", "mpeg4", {"g": "10"}),
        ("mpg", "mpeg2video", {"g": "10"}),
    ],
)
def test_a_recording_that_begins_between_keyframes_starts_at_the_first_one(suffix, codec, options, tmp_path):
    rate = 25 if suffix == "mpg" else FPS
    whole = write_video(tmp_path / f"whole.{suffix}", codec, size=SQUARE, options=options, rate=rate)
    video = VideoFile(remux(tmp_path / f"x.{suffix}", whole, first=4))
    assert numbers(video) == list(range(10, COUNT)) and not video.cut and not video.damage
    np.testing.assert_allclose(video.times, np.arange(COUNT - 10) / rate, atol=2e-3)
    assert any("begins between keyframes" in note for note in video.notes)
    assert VideoFile(whole).notes == []


@pytest.mark.parametrize(
    ("suffix", "codec", "options"),
    [
        ("mp4", "libx264", {"g": "12", "bf": "3", "sc_threshold": "0"}),
        ("mkv", "libx264", {"g": "12", "bf": "3", "sc_threshold": "0"}),
        ("mp4", "libx265", {"x265-params": "log-level=none:keyint=12:min-keyint=12:open-gop=0:scenecut=0"}),
        ("mp4", "mpeg4", {"g": "12", "bf": "2", "sc_threshold": "1000000000"}),
        ("mov", "mjpeg", {}),
        ("avi", "mjpeg", {}),
        ("webm", "libvpx-vp9", {"g": "12", "keyint_min": "12", "deadline": "realtime", "cpu-used": "8"}),
    ],
)
def test_damage_is_told_of_where_it_reaches(suffix, codec, options, tmp_path):
    pixels = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    path = write_video(tmp_path / f"x.{suffix}", codec, pixels, size=(64, 64), options=options)
    assert len(numbers(VideoFile(path))) == COUNT
    damage(path, range(5, 8))
    video = VideoFile(path)
    assert not video.cut and len(video.times) == COUNT
    told = set()
    for k in range(COUNT):
        try:
            right = numbers(video, [0, k])[-1] == k
        except ArtifactError as error:
            assert f"cannot be decoded at {k / FPS:.2f} s" in str(error)
            told.add(k)
        else:
            assert right or video.damage
            told |= {k} if video.damage else set()
    assert {7} <= told <= set(range(3, 12))
    assert numbers(video, [0, 2, 12, 24]) == [0, 2, 12, 24] and not video.damage


def test_nothing_that_can_be_decoded(tmp_path):
    path = write_video(tmp_path / "x.mp4", size=SQUARE)
    damage(path, range(COUNT))
    with pytest.raises(ArtifactError, match=r"x\.mp4: cannot be decoded: replace the file"):
        VideoFile(path)


def test_logging_of_the_libraries_is_left_as_it_was(tmp_path):
    before = av.logging.get_level(), av.logging.get_skip_repeated()
    assert numbers(VideoFile(write_video(tmp_path / "x.mp4", size=SQUARE)))[:2] == [0, 1]
    assert (av.logging.get_level(), av.logging.get_skip_repeated()) == before


@pytest.mark.parametrize(("between", "flips"), [("3", 2), ("0", 1)])
def test_what_a_decoder_conceals_is_told(between, flips, tmp_path):
    """Bits that change at random in the images: whatever FFmpeg notices when it decodes the whole video is told."""
    options = {"g": "6", "threads": "1", "bf": between, "b_strategy": "0"}
    path = write_video(tmp_path / "x.mp4", size=SQUARE, count=12, options=options)
    with av.open(str(path)) as container:
        packets = [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size][1:]
    raw, indices = path.read_bytes(), np.array([0, 2, 5, 8, 11])
    truth = [frame.astype(int) for _, frame in VideoFile(path).pictures(indices)]
    told = 0
    for seed in range(250):
        data = bytearray(raw)
        rng = np.random.default_rng(seed)
        for begin, size in rng.choice(packets, flips):
            data[begin + rng.integers(4, size)] ^= 1 << rng.integers(8)
        path.write_bytes(data)
        try:
            video = VideoFile(path)
            if video.cut or video.notes or len(video.times) != 12:
                continue
            pairs = zip(list(video.pictures(indices)), truth, strict=True)
            worst = max(np.abs(frame - right).mean() for (_, frame), right in pairs if frame.shape == right.shape)
        except (ArtifactError, ValueError):
            continue
        told += bool(video.damage)
        assert video.damage or worst < DIFFERENT or not decoder_complains(path), seed
    assert told > 20


def test_what_is_predicted_from_a_concealed_image_is_damaged_too():
    """FFmpeg marks only the concealed image itself."""
    damage_of, packet = Damage(), SimpleNamespace(is_corrupt=False, is_keyframe=True, pts=0)
    for stamp, key in ((0, True), (1, False), (2, False)):
        packet.pts, packet.is_keyframe = stamp, key
        damage_of.begin(packet)
        damage_of.end(packet, False)
    damage_of.spread(1, {2})
    for stamp, key in ((3, False), (4, True), (5, False)):
        packet.pts, packet.is_keyframe = stamp, key
        damage_of.begin(packet)
        damage_of.end(packet, False)
    assert [damage_of.reached(stamp) for stamp in range(6)] == [False, False, True, True, False, False]
    damage_of.spread(3, {4, 5})  # It is returned after the next keyframe was decoded.
    assert [damage_of.reached(stamp) for stamp in range(6)] == [False, False, True, True, False, False]
