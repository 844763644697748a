"""Any frames of any kind of file, by going to key frames or by decoding through, are the same frames."""

from __future__ import annotations

from types import SimpleNamespace

import av
import numpy as np
import pytest

import stages.footage.decoding as decoding_module
from artifacts import ArtifactError, read_mp4
from stages.footage.display import orientation
from stages.footage.sources import find_videos, natural_order
from stages.footage.video import VideoFile
from tests.stages.videos import X265, cut, number_in, write_video

COUNT = 60  # frames
KINDS = {
    "open-gop.mp4": {"options": {"g": "7", "bf": "3", "x264-params": "open-gop=1:b-pyramid=normal"}},
    "open-gop.ts": {"options": {"g": "7", "bf": "3", "x264-params": "open-gop=1"}},
    "refresh.mkv": {"options": {"g": "10", "x264-params": "intra-refresh=1"}},
    "hevc.mp4": {"codec": "libx265", "options": {"x265-params": f"{X265['x265-params']}:keyint=8:open-gop=1"}},
    "av1.mp4": {"codec": "libsvtav1", "options": {"g": "17", "preset": "8", "crf": "12"}},
    "vp9.webm": {"codec": "libvpx-vp9", "options": {"g": "9", "cpu-used": "8", "deadline": "realtime"}},
    "mpeg4.avi": {"codec": "mpeg4", "options": {"g": "9", "bf": "2"}},
    "mpeg2.mpg": {"codec": "mpeg2video", "options": {"g": "9", "bf": "2"}, "rate": 25},
    "intra.mov": {"codec": "mjpeg", "pixels": "yuvj420p"},
}


@pytest.mark.parametrize("name", KINDS)
def test_frames_are_the_same_however_far_apart(name, tmp_path):
    path = write_video(tmp_path / name, count=COUNT, size=(96, 96), **KINDS[name])
    video = VideoFile(path)
    assert len(video.times) == COUNT and not video.cut
    rng = np.random.default_rng(0)
    for n in (1, 3, 8, COUNT):
        indices = np.sort(rng.choice(COUNT, n, replace=False))
        shown = [(time, number_in(frame)) for time, frame in video.pictures(indices)]
        assert [number for _, number in shown] == list(indices)
        np.testing.assert_allclose([time for time, _ in shown], video.times[indices], atol=1e-3)


def test_only_what_is_wanted_is_decoded(tmp_path, monkeypatch):
    """A few key frames of a long video need no others."""
    path = write_video(tmp_path / "x.mp4", count=COUNT, options={"g": "10", "sc_threshold": "0"})
    decoded, real = [], decoding_module.decoded
    monkeypatch.setattr(
        decoding_module, "decoded", lambda *words: map(lambda f: decoded.append(f.pts) or f, real(*words))
    )
    assert len(list(VideoFile(path).pictures(np.array([0, 20, 51])))) == 3
    assert len(decoded) < 8


def test_a_damaged_part_is_said_where_it_is_wanted(tmp_path):
    path = write_video(tmp_path / "x.mp4", count=COUNT, size=(96, 96), options={"g": "6"})
    with av.open(str(path)) as file:
        packets = [(p.pos, p.size, p.pts) for p in file.demux(video=0) if p.size]
        unit = float(file.streams.video[0].time_base)
    data = bytearray(path.read_bytes())
    for pos, size, pts in packets:
        if 3.0 <= pts * unit < 3.6:
            data[pos : pos + size] = b"\xff" * size
    path.write_bytes(bytes(data))
    video = VideoFile(path)
    assert [number_in(frame) for _, frame in video.pictures(np.array([0, 12, 48]))] == [0, 12, 48]
    with pytest.raises(ArtifactError, match=r"x.mp4: cannot be decoded at 3\.\d\d s"):
        list(video.pictures(np.array([0, 33, 48])))


@pytest.mark.parametrize(
    ("matrix", "expected"),
    [
        ([1, 0, 0, 1], (False, 0)),
        ([0, 1, -1, 0], (False, -90)),
        ([-1, 0, 0, 1], (True, 0)),
        ([1, 0, 0, -1], (True, 180)),
    ],
)
def test_orientation(matrix, expected):
    a, b, c, d = (65536 * value for value in matrix)

    side_data = {"DISPLAYMATRIX": np.array([a, b, 0, c, d, 0, 0, 0, 1 << 30], "<i4").tobytes()}
    mirrored, angle = orientation(SimpleNamespace(side_data=side_data))
    assert (mirrored, angle % 360) == (expected[0], expected[1] % 360)


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_orientation_without_side_data(turns, tmp_path):
    """PyAV before 19 raises where a frame has side data that is newer than it; the angle is told all the same."""

    class Unnamed:
        def __init__(self, frame):
            self.rotation = frame.rotation

        @property
        def side_data(self):
            raise ValueError("36 is not a valid Type")

    path = write_video(tmp_path / "x.mp4", turns=turns, count=2)
    with av.open(str(path)) as file:
        frame = next(file.decode(video=0))
    mirrored, angle = orientation(frame)
    assert (mirrored, angle % 360) == (False, 90 * turns)
    assert orientation(Unnamed(frame)) == (mirrored, pytest.approx(angle, abs=1)) or turns == 2
    assert round(orientation(Unnamed(frame))[1] / 90) % 4 == turns


@pytest.mark.parametrize("name", ["x.mp4", "x.mkv", "x.avi"])
def test_metadata_that_is_not_utf8_is_ignored(name, tmp_path):
    """Cameras write their owner's name in whatever encoding they like."""
    path = write_video(tmp_path / name, size=(48, 48), metadata={"title": "caf__ title"})
    path.write_bytes(path.read_bytes().replace(b"caf__ title", b"caf\xe9\xff title"))
    assert b"caf\xe9\xff title" in path.read_bytes()
    shown = [number_in(frame) for _, frame in VideoFile(path).pictures(np.arange(25))]
    assert shown == list(range(25)) == [number_in(frame) for frame in read_mp4(path)]


def test_folders(tmp_path):
    names = ["b10.mp4", "b2.MOV", "B1.mp4", "notes.txt", "cover.png", ".b3.mp4"]
    for name in names:
        (tmp_path / name).touch()
    assert [source.path.name for source in find_videos(tmp_path)] == ["B1.mp4", "b2.MOV", "b10.mp4"]
    assert sorted(map(tmp_path.joinpath, ["10", "9", "a"]), key=natural_order)[0].name == "9"
    with pytest.raises(ArtifactError, match="contains no videos or images"):
        (tmp_path / "inner").mkdir()
        find_videos(tmp_path / "inner")
    with pytest.raises(ArtifactError, match="not a regular file"):
        find_videos(type(tmp_path)("/dev/null"))


def test_what_was_trimmed_without_encoding_again_is_not_shown(tmp_path):
    """Phones trim by an edit list: frames before the cut are still there, for others to be decoded from."""
    whole, path = write_video(tmp_path / "x.mp4", size=(48, 48), options={"g": "12", "bf": "2"}), tmp_path / "y.mp4"
    with av.open(str(whole)) as source, av.open(str(path), "w", options={"avoid_negative_ts": "disabled"}) as trimmed:
        stream = trimmed.add_stream_from_template(source.streams.video[0], opaque=True)
        before = round(0.5 / source.streams.video[0].time_base)
        for packet in source.demux(video=0):
            if packet.size:
                packet.pts, packet.dts, packet.stream = packet.pts - before, packet.dts - before, stream
                trimmed.mux(packet)
    video = VideoFile(path)
    shown = [number_in(frame) for _, frame in video.pictures(np.arange(len(video.times)))]
    assert shown == list(range(5, 25)) and not video.cut


@pytest.mark.parametrize("reordered", [0, 3])
def test_a_truncated_file_is_read_without_gaps_up_to_where_it_ends(reordered, tmp_path):
    """Frames that are shown later may be stored earlier, and are left out where those between them are missing."""
    options = {"bf": str(reordered), "g": "12", "b_strategy": "0"}
    whole = write_video(tmp_path / "x.mkv", count=COUNT, options=options)
    for percent in range(70, 98, 4):
        path = cut(whole, tmp_path / f"{percent}.mkv", percent / 100)
        video = VideoFile(path)
        with av.open(str(path)) as file:
            stored = sum(packet.size > 0 for packet in file.demux(video=0))
        assert stored - reordered <= len(video.times) <= stored and video.cut
        np.testing.assert_allclose(np.diff(video.times), 0.1, atol=1e-6)
