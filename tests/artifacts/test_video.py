"""Videos and pictures as a player or a browser will meet them."""

from __future__ import annotations

import av
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from artifacts import (
    ArtifactError,
    PlatformError,
    contact_sheet,
    mp4_bytes,
    png_bytes,
    read_mp4,
    read_png,
    tile_videos,
    write_mp4,
    write_overview,
    write_png,
)

COLOURS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255], [0, 0, 0], [200, 100, 50]], np.uint8)


def moving_square(t=12, h=24, w=32):
    """A red square on blue-grey, moving right."""
    frames = np.full((t, h, w, 3), (60, 80, 120), np.uint8)
    for i in range(t):
        frames[i, 8:16, i : i + 8] = (220, 40, 30)
    return frames


def boxes(data):
    """The MP4's top-level boxes, in order."""
    names, at = [], 0
    while at < len(data):
        names.append(data[at + 4 : at + 8].decode())
        at += int.from_bytes(data[at : at + 4], "big")
    return names


def test_an_mp4_plays_everywhere(tmp_path, leftovers):
    path = write_mp4(tmp_path / "new" / "a.mp4", moving_square(), fps=10)
    order = boxes(path.read_bytes())
    assert order.index("moov") < order.index("mdat")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264" and stream.codec_context.pix_fmt == "yuv420p"
        assert (stream.width, stream.height, stream.frames) == (256, 192, 12)
        assert stream.average_rate == 10
    assert leftovers() == []


def test_decoded_frames_are_near_the_originals(tmp_path):
    frames = moving_square()
    found = read_mp4(write_mp4(tmp_path / "a.mp4", frames))
    assert found.shape == (12, 192, 256, 3) and found.dtype == np.uint8
    assert np.abs(found[:, 4::8, 4::8].astype(int) - frames).mean() < 3
    assert found[0, 96, 32, 0] > 200 > 60 > found[0, 96, 32, 2], "red must stay red"


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(1, 5), st.integers(1, 49), st.integers(1, 49), st.sampled_from([1, 24, 29.97, 0.5]))
def test_any_size_gives_even_dimensions(tmp_path, t, h, w, fps):
    frames = np.random.default_rng(0).integers(0, 256, (t, h, w, 3), dtype=np.uint8)
    found = read_mp4(write_mp4(tmp_path / "a.mp4", frames, fps=fps, min_height=20))
    factor = -(-20 // h)
    assert found.shape == (t, h * factor + h * factor % 2, w * factor + w * factor % 2, 3)


def test_bad_videos_are_one_line(tmp_path, capfd):
    whole = write_mp4(tmp_path / "a.mp4", moving_square(40)).read_bytes()
    cases = {"empty": b"", "text": b"hello" * 100, "cut": whole[:-200], "half": whole[: len(whole) // 2]}
    for name, content in cases.items():
        path = tmp_path / f"{name}.mp4"
        path.write_bytes(content)
        with pytest.raises(ArtifactError, match=f"{name}.mp4") as caught:
            read_mp4(path)
        assert "\n" not in str(caught.value)
    for path in (tmp_path / "none.mp4", tmp_path):
        with pytest.raises(ArtifactError, match="cannot be read as a video"):
            read_mp4(path)
    assert capfd.readouterr() == ("", "")


def test_a_failed_video_leaves_the_old_one(tmp_path, leftovers, monkeypatch):
    path = write_mp4(tmp_path / "a.mp4", moving_square())
    before = path.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr("artifacts.video.upscale", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write_mp4(path, moving_square(3))
    with pytest.raises(ValueError, match="expected 4 axes"):
        write_mp4(path, moving_square()[0])
    (tmp_path / "folder").mkdir()
    with pytest.raises(PlatformError, match="cannot be written"):
        write_mp4(tmp_path / "folder", moving_square())
    assert path.read_bytes() == before and leftovers() == []


def test_png_keeps_every_colour(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (17, 9, 3), dtype=np.uint8)
    image[0, :6] = COLOURS
    np.testing.assert_array_equal(read_png(write_png(tmp_path / "a.png", image)), image)
    with av.open(str(tmp_path / "a.png")) as container:  # another decoder sees red as red
        seen = next(container.decode(video=0)).to_ndarray(format="rgb24")
    np.testing.assert_array_equal(seen, image)


def test_bad_pictures_are_one_line(tmp_path):
    (tmp_path / "text.png").write_text("hello")
    (tmp_path / "empty.png").write_text("")
    for name in ("text.png", "empty.png", "none.png"):
        with pytest.raises(ArtifactError, match=name) as caught:
            read_png(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_tiles_hold_the_last_frame_and_repeat_stills():
    long, short, still = moving_square(6), moving_square(2), moving_square(1)[0]
    tiled = tile_videos([[long, short], [still]], gap=3, scale=2)
    assert tiled.shape == (6, 2 * 48 + 3, 2 * 64 + 3, 3)
    cell = tiled[:, :48:2, :64:2]
    np.testing.assert_array_equal(cell, long)
    np.testing.assert_array_equal(tiled[:, :48:2, 67::2], short[[0, 1, 1, 1, 1, 1]])
    np.testing.assert_array_equal(tiled[4, 51::2, :64:2], still)
    assert (tiled[:, 48:51] == 255).all() and (tiled[:, 51:, 64:] == 255).all()


def test_labels_stand_above_their_columns():
    videos = [moving_square(2)] * 2
    plain = tile_videos([videos])
    labelled = tile_videos([videos], labels=["source", "a very long label that must shrink"])
    header = labelled.shape[1] - plain.shape[1]
    np.testing.assert_array_equal(labelled[:, header:], plain)
    ink = (labelled[0, :header] < 128).any(axis=(0, 2))
    assert ink[:128].any() and ink[130:].any() and not ink[128:130].any()
    with pytest.raises(ValueError, match="1 labels for 2 columns"):
        tile_videos([videos], labels=["one"])


def test_rows_have_labels_and_cells_may_be_texts():
    video = moving_square(3)
    plain = tile_videos([[video, video], [video, video]])
    labelled = tile_videos([[video, video], ["mean of 8", video]], row_labels=["demo 12", "target"])
    left = labelled.shape[2] - plain.shape[2]
    np.testing.assert_array_equal(labelled[:, :96, left:], plain[:, :96])
    np.testing.assert_array_equal(labelled[:, 98:, left + 130 :], plain[:, 98:, 130:])
    for y, x, width in ((0, 0, left), (98, 0, left), (98, left, 128)):
        cell = labelled[:, y : y + 96, x : x + width]
        ink = (cell < 128).all(axis=-1)
        rows, columns = np.flatnonzero(ink[0].any(axis=1)), np.flatnonzero(ink[0].any(axis=0))
        assert (cell[0] == cell[-1]).all() and len(rows) >= 8, "legible, and in every frame"
        assert 30 < rows.mean() < 66 and columns[0] > 2 and columns[-1] < width - 2, "in the middle, not cut off"
        assert (cell[0, 0] == 255).all()
    with pytest.raises(ValueError, match="1 labels for 2 rows"):
        tile_videos([[video], [video]], row_labels=["one"])
    with pytest.raises(ValueError, match="at least one video"):
        tile_videos([["text"]])


def test_pictures_and_videos_for_pages_are_those_of_the_files(tmp_path):
    video = moving_square(3)
    assert mp4_bytes(video) == write_mp4(tmp_path / "a.mp4", video).read_bytes()
    assert png_bytes(video[0]) == write_png(tmp_path / "a.png", video[0]).read_bytes()


def test_no_room_for_a_temporary_file_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "none"))
    with pytest.raises(PlatformError, match="no temporary file can be written"):
        mp4_bytes(moving_square(1))


def test_a_contact_sheet_shows_first_and_last_of_each():
    frames = np.zeros((45, 9, 4, 4, 3), np.uint8)
    frames[..., 0] = np.arange(45)[:, None, None, None]
    frames[..., 1] = np.arange(9)[:, None, None]
    sheet = contact_sheet(frames, n=20, moments=5)
    assert sheet.shape == (10 * 8 + 9 * 2, 10 * 8 + 9 * 2, 3)
    cells = sheet[::10, ::10]
    assert cells[0, :5, 1].tolist() == cells[9, 5:, 1].tolist() == [0, 2, 4, 6, 8]
    assert cells[0, 0, 0] == 0 and cells[9, 9, 0] == 44
    assert contact_sheet(frames[:1], n=20, moments=3).shape == (8, 28, 3)


def test_an_overview_shows_the_first_videos_in_a_grid_and_fills_its_last_row(tmp_path):
    videos = np.full((7, 2, 100, 400, 3), 40, np.uint8)  # so wide that three fit in a row of the MP4
    videos += np.arange(0, 140, 20, dtype=np.uint8)[:, None, None, None, None]
    paths = write_overview(tmp_path / "x.demos.h5", videos)
    assert paths == {"contact_sheet": str(tmp_path / "x.demos.png"), "video": str(tmp_path / "x.demos.mp4")}
    np.testing.assert_array_equal(read_png(paths["contact_sheet"]), contact_sheet(videos, n=20))
    shown = read_mp4(paths["video"])
    assert shown.shape == (2, 3 * 100 + 2 * 2, 3 * 400 + 2 * 2, 3)
    centers = shown[1, 50::102, 200::402].mean(axis=-1)
    np.testing.assert_allclose(centers, [[40, 60, 80], [100, 120, 140], [160, 0, 0]], atol=3)
