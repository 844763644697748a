"""Files that would hang a reader or fill the memory are refused at once, before they are decoded."""

from __future__ import annotations

import os
import struct
import time
import tracemalloc
import zlib

import cv2
import numpy as np
import pytest

from artifacts import ArtifactError, UsageError, image_size, open_regular, open_video, read_png, sha256_of
from stages.config.demonstrations import Crop, parse_crop
from stages.config.stages import TranslateConfig
from stages.footage.claims import lacks_bytes, loses_sync
from stages.footage.crops import read_crops
from stages.footage.images import decoded
from stages.footage.moments import Segment, choose_frames
from stages.footage.sources import Source, find_videos
from stages.footage.video import VideoFile
from stages.translate import _image_digest
from tests.stages.videos import write_video


@pytest.fixture
def quick():
    """Fails if the test takes long or much memory."""
    tracemalloc.start()
    began = time.monotonic()
    yield
    assert time.monotonic() - began < 2 and tracemalloc.get_traced_memory()[1] < 64 * 2**20
    tracemalloc.stop()


@pytest.fixture(params=["pipe", "device", "loop", "folder"])
def unreadable(request, tmp_path):
    """What is no regular file."""
    path = tmp_path / "odd" / "x.mp4"
    path.parent.mkdir()
    if request.param == "pipe":
        os.mkfifo(path)
    elif request.param == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero" if request.param == "device" else path)
    return path


def test_what_is_no_regular_file_is_refused_by_every_reader(unreadable, quick):
    for read in (open_regular, open_video):
        with pytest.raises(OSError, match=r"not a regular file|Is a directory|Too many levels"):
            read(unreadable)
    for read in (sha256_of, read_png, VideoFile, lambda path: read_crops(path, [])):
        with pytest.raises(ArtifactError, match=r"x\.mp4: cannot be read \((not a regular|Is a dir|Too many)"):
            read(unreadable)
    with pytest.raises(ArtifactError, match=r"x\.mp4: cannot be read"):
        next(Source(unreadable.parent, (unreadable,)).open().pictures(np.array([0])))
    with pytest.raises(UsageError, match=r"--context-image .*x\.mp4: cannot be read"):
        _image_digest(TranslateConfig(context_image=str(unreadable)))
    with pytest.raises(ArtifactError, match=r"not a regular file|no such file|contains no videos"):
        find_videos(unreadable)


def test_pipes_in_a_folder_are_not_passed_over(tmp_path):
    os.mkfifo(tmp_path / "x.mp4")
    assert [source.path.name for source in find_videos(tmp_path)] == ["x.mp4"]


def png(width, height, path=None):
    """A PNG whose header says this, though it has hardly any data."""

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(99))) + chunk(b"IEND", b"")


def jpeg(width, height):
    """A JPEG whose header says this."""
    data = bytearray(cv2.imencode(".jpg", np.zeros((32, 48, 3), np.uint8))[1].tobytes())
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">HH", height, width)
    return bytes(data)


@pytest.mark.parametrize("size", [(30000, 30000), (65535, 65535), (16384, 16384)])
@pytest.mark.parametrize("make", [png, jpeg])
def test_the_size_of_an_image_is_checked_before_it_is_decoded(make, size, tmp_path, monkeypatch):
    data = make(*size)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("was decoded"))
    assert image_size(data) == size and decoded(data) is None
    (tmp_path / "x.png").write_bytes(data)
    with pytest.raises(ArtifactError, match=rf"x\.png: its image has {size[0]}x{size[1]} pixels"):
        read_png(tmp_path / "x.png")
    with pytest.raises(ArtifactError, match=rf"x\.png: its image has {size[0]}x{size[1]} pixels"):
        next(find_videos(tmp_path)[0].open().pictures(np.array([0])))


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_the_size_in_a_header_is_that_of_the_image(suffix):
    data = cv2.imencode(suffix, np.zeros((33, 47, 3), np.uint8))[1].tobytes()
    assert image_size(data) == (47, 33)
    for broken in (b"", data[:3], data[:20], b"GIF89a" + data, data[:2] + bytes(40)):
        assert image_size(broken) is None


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_what_follows_an_image_does_not_matter(suffix):
    """Phones append a video that is longer than the image."""
    image = np.random.default_rng(0).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    data = cv2.imencode(suffix, image)[1].tobytes()
    np.testing.assert_array_equal(decoded(data + bytes(3 * len(data))), decoded(data))
    for length in range(20, len(data), 97):
        assert decoded(data[:length]) is None


def with_samples(path, count):
    """A video whose header claims this many frames of equal size."""
    data = bytearray(write_video(path).read_bytes())
    at = data.index(b"stsz")
    data[at + 8 : at + 16] = struct.pack(">II", 40, count)
    at = data.index(b"stts")
    data[at + 8 : at + 20] = struct.pack(">III", 1, count, 512)
    at = data.index(b"stsc")
    data[at + 8 : at + 24] = struct.pack(">IIII", 1, 1, count, 1)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("count", [10**7, 10**9])
def test_a_video_that_claims_more_frames_than_it_has_bytes_is_refused(count, tmp_path, quick, monkeypatch):
    path = with_samples(tmp_path / "x.mp4", count)
    monkeypatch.setattr("stages.footage.container.open_video", lambda _: pytest.fail("was opened"))
    with pytest.raises(ArtifactError, match=rf"x\.mp4: claims {count} frames in \d+ bytes"):
        VideoFile(path)


def test_a_fragment_that_claims_more_frames_than_it_has_bytes_is_refused(tmp_path, quick):
    path = write_video(tmp_path / "x.mp4", container={"movflags": "+frag_keyframe+empty_moov"})
    assert len(VideoFile(path).times) == 25
    data = bytearray(path.read_bytes())
    at = data.index(b"trun")
    data[at + 4 : at + 12] = struct.pack(">II", 1, 10**9)
    path.write_bytes(data)
    with pytest.raises(ArtifactError, match="claims 1000000000 frames"):
        VideoFile(path)


def test_boxes_without_end_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("stages.footage.claims.MOST_BOXES", 1000)
    path = write_video(tmp_path / "x.mp4")
    assert len(VideoFile(path).times) == 25
    path.write_bytes(path.read_bytes() + b"\0\0\0\x08free" * 1000)
    with pytest.raises(ArtifactError, match=r"x\.mp4: has more than 1000 boxes"):
        VideoFile(path)


@pytest.mark.parametrize("name", ["x.mp4", "x.mkv", "x.avi", "x.webm", "x.ts", "f.mp4", "live.mkv", "x.flv", "x.wmv"])
def test_only_a_shortened_file_lacks_bytes(name, tmp_path):
    codec = {"webm": "libvpx", "wmv": "wmv2"}.get(name.rpartition(".")[2], "libx264")
    container = {"f.mp4": {"movflags": "+frag_keyframe+empty_moov"}, "live.mkv": {"live": "1"}}.get(name, {})
    if name == "x.mp4":
        container = {"movflags": "+faststart"}
    path = write_video(tmp_path / name, codec, container=container)
    assert not lacks_bytes(path)
    data = path.read_bytes()
    path.write_bytes(data + b"trailing bytes " * 9)
    assert not lacks_bytes(path)
    path.write_bytes(data[: -len(data) // 4])
    assert lacks_bytes(path) == (name not in ("x.ts", "live.mkv"))


@pytest.mark.parametrize(
    "content", [b"", b"\0" * 9, b"RIFF", b"\x1a\x45\xdf\xa3", b"\0\0\0\1mdat\0", b"\0\0\0\0moov" * 99]
)
def test_fragments_of_headers(content, tmp_path):
    (tmp_path / "x.mp4").write_bytes(content)
    with pytest.raises(ArtifactError, match=r"x\.mp4: is (empty|not a video)"):
        VideoFile(tmp_path / "x.mp4")


@pytest.mark.parametrize("number", ["9" * 400, "9" * 5000, "1_0", "1e3", "\u0661", "+1", "-0", "", "1\0"])
def test_crops_are_short_plain_numbers(number, tmp_path):
    with pytest.raises(UsageError, match=r"expected X,Y,W,H in whole pixels") as caught:
        parse_crop(f"{number},0,9,9")
    assert len(str(caught.value)) < 200
    (tmp_path / "crops.csv").write_text(f"video,x,y,w,h\nx.mp4,{number},0,9,9\n")
    with pytest.raises(ArtifactError, match=r"crops\.csv, line 2: expected x,y,w,h in whole pixels"):
        read_crops(tmp_path / "crops.csv", [])
    assert parse_crop(" 1, 2,3 ,004") == Crop(1, 2, 3, 4)


def test_crop_files_have_a_limit(tmp_path, quick):
    (tmp_path / "crops.csv").write_bytes(b"video,x,y,w,h\n" + b"a.mp4,0,0,9,9\n" * 10**6)
    with pytest.raises(ArtifactError, match=r"crops\.csv: is larger than 4 MB"):
        read_crops(tmp_path / "crops.csv", [])


def test_links_that_lead_to_themselves_in_a_crop_file(tmp_path):
    (tmp_path / "x.mp4").symlink_to(tmp_path / "x.mp4")
    (tmp_path / "crops.csv").write_text("video,x,y,w,h\nx.mp4,0,0,9,9\n")
    assert read_crops(tmp_path / "crops.csv", [Source(tmp_path / "x.mp4")]) == ([Crop(0, 0, 9, 9)], [])


@pytest.mark.filterwarnings("error")
def test_any_finite_rate_can_be_asked_for(tmp_path):
    video = VideoFile(write_video(tmp_path / "x.mp4"))
    indices, behind = choose_frames(video, Segment(3, fps=1e-320))
    assert indices.tolist() == [0, 24, 24] and behind == 2


def blocks(count, stride=188, seed=0):
    """A transport stream's blocks, with any content."""
    data = np.random.default_rng(seed).integers(0, 0x40, (count, stride), dtype=np.uint8)
    data[:, stride - 188] = 0x47
    return data.tobytes()


@pytest.mark.parametrize("stride", [188, 192, 204])
def test_what_lies_between_the_blocks_of_a_transport_stream_is_found(stride, tmp_path):
    path, whole = tmp_path / "x.ts", blocks(500, stride)
    for right in (whole, b"\0" * 99 + whole, whole[77:], whole[:-77], whole + b"\0" * 9999):
        path.write_bytes(right)
        assert not loses_sync(path)
    zeros = bytearray(whole)
    zeros[30000:31000] = bytes(1000)
    for wrong in (zeros, whole[:30000] + whole[30500:], whole[:30000] + b"between" + whole[30000:]):
        path.write_bytes(wrong)
        assert loses_sync(path)


@pytest.mark.parametrize("content", [b"\x47" * 9, b"\0" * 9999])
def test_what_is_no_transport_stream_cannot_lose_it(content, tmp_path):
    (tmp_path / "x.ts").write_bytes(content)
    assert not loses_sync(tmp_path / "x.ts")
