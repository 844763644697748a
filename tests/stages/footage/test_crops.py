"""Crops: how they are named, in files and on the command line, and what they take of a picture."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from artifacts import ArtifactError, UsageError
from stages.config.demonstrations import Crop, parse_crop
from stages.footage.crops import centred_crop, check_crop, read_crops, reduced
from stages.footage.sources import Source


@pytest.mark.parametrize(("text", "crop"), [("200,0,720,480", (200, 0, 720, 480)), ("0,7,1,1", (0, 7, 1, 1))])
def test_a_crop_is_four_whole_numbers(text, crop):
    assert parse_crop(text) == crop
    assert parse_crop(text)._fields == ("x", "y", "w", "h")


@pytest.mark.parametrize(
    "text", ["", "1,2,3", "1,2,3,4,5", "1,2,3,x", "1.5,2,3,4", "-1,0,5,5", "0,-1,5,5", "0,0,0,5", "0,0,5,0"]
)
def test_what_is_no_rectangle_is_refused(text):
    with pytest.raises(UsageError, match="expected X,Y,W,H") as caught:
        parse_crop(text)
    assert repr(text) in str(caught.value)


@pytest.fixture
def table(tmp_path):
    """A function (lines) -> what a CSV of crops says of a.mp4, sub/b.mp4 and a data set."""
    (tmp_path / "sub").mkdir()
    sources = [
        Source(tmp_path / "a.mp4"),
        Source(tmp_path / "sub" / "b.mp4"),
        Source(tmp_path / "set", part="episode 3"),
    ]

    def read(*lines, encoding="utf-8", only=None):
        path = tmp_path / "crops.csv"
        path.write_text("\n".join(lines) + "\n", encoding=encoding)
        return read_crops(path, sources if only is None else [sources[k] for k in only])

    return read


HEAD = "video,x,y,w,h"


def test_rows_are_found_by_path_or_by_name(table):
    crops, others = table(HEAD, "a.mp4,1,2,3,4", "sub/b.mp4,5,6,7,8", "set,9,10,11,12")
    assert crops == [(1, 2, 3, 4), (5, 6, 7, 8), (9, 10, 11, 12)] and others == []
    assert table(HEAD, "b.mp4,5,6,7,8", only=[1])[0] == [(5, 6, 7, 8)]
    both = table(HEAD, "b.mp4,1,1,1,1", "sub/b.mp4,5,6,7,8", only=[1])
    assert both == ([(5, 6, 7, 8)], ["b.mp4"]), "the path tells more than the name"


def test_columns_come_in_any_order_and_others_may_stand_between(table):
    crops, others = table("h,w,note,video,y,x", "4,3,first, a.mp4,2,1", "1,1,,z.mp4,0,0", "1,1,,c.mp4,0,0", only=[0])
    assert crops == [(1, 2, 3, 4)]
    assert others == ["c.mp4", "z.mp4"]


def test_a_spreadsheets_byte_order_mark_is_no_part_of_a_name(table):
    assert table(HEAD, "a.mp4,1,2,3,4", encoding="utf-8-sig", only=[0])[0] == [(1, 2, 3, 4)]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["video,x,y,w", "a.mp4,1,2,3"], "has no column 'h': expected video,x,y,w,h in line 1"),
        ([""], "has no column 'video'"),
        ([HEAD, "b.mp4,1,2,3,4", "a.mp4,1,2,3,x"], r"crops\.csv, line 3: expected x,y,w,h in whole pixels"),
        ([HEAD, "a.mp4,1,2,3"], "line 2: expected x,y,w,h"),
        ([HEAD, ",1,2,3,4"], "line 2: expected the name of a video"),
        ([HEAD, "a\0.mp4,1,2,3,4"], "line 2: expected the name of a video"),
        ([HEAD, "a.mp4,1,2,3,4", "b.mp4,1,1,1,1", "a.mp4,1,2,3,4"], "line 4: second row for a.mp4"),
        ([HEAD, "b.mp4,1,2,3,4"], r"has no row for .*a\.mp4: add one with video,x,y,w,h"),
        ([HEAD], r"has no row for .*a\.mp4, nor for 2 others: add one"),
    ],
)
def test_what_a_file_lacks_is_said_with_its_line(table, lines, message):
    with pytest.raises(ArtifactError, match=message) as caught:
        table(*lines, only=None if lines == [HEAD] else [0])
    assert "\n" not in str(caught.value)


def test_files_that_are_no_csv_are_refused(tmp_path, table):
    with pytest.raises(ArtifactError, match=r"none\.csv: cannot be read \(No such file"):
        read_crops(tmp_path / "none.csv", [])
    with pytest.raises(ArtifactError, match="not a UTF-8 CSV file"):
        table(HEAD, "ä.mp4,1,2,3,4", encoding="latin-1")


@pytest.mark.parametrize(
    ("picture", "size", "crop"),
    [
        ((480, 640), (48, 48), (80, 0, 480, 480)),
        ((640, 480), (48, 48), (0, 80, 480, 480)),
        ((100, 100), (25, 50), (0, 25, 100, 50)),
        ((101, 100), (48, 48), (0, 0, 100, 100)),
        ((24, 30), (48, 48), (3, 0, 24, 24)),
        ((16, 16), (1, 100), (0, 7, 16, 1)),
        ((16, 16), (100, 1), (7, 0, 1, 16)),
    ],
)
def test_the_largest_centred_crop_has_the_frames_shape(picture, size, crop):
    assert centred_crop(picture, size) == crop


def test_a_crop_may_reach_the_edge_and_not_beyond():
    check_crop(Crop(100, 20, 540, 460), (480, 640), "x.mp4")
    for beyond in (Crop(101, 20, 540, 460), Crop(100, 21, 540, 460)):
        with pytest.raises(ArtifactError, match=r"x\.mp4: the crop \d+,2.,540,460 extends beyond its image of 640x480"):
            check_crop(beyond, (480, 640), "x.mp4")


def test_pictures_are_reduced_by_area_and_enlarged_linearly():
    picture = np.random.default_rng(0).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    small = reduced(picture, Crop(10, 4, 24, 16), (4, 8))
    assert small.shape == (4, 8, 3)
    means = picture[4:20, 10:34].reshape(4, 4, 8, 3, 3).mean(axis=(1, 3))
    assert np.abs(small - means).max() <= 0.51
    part = picture[4:20, 10:34]
    for size in ((20, 8), (4, 30), (20, 30)):  # one side larger is enough
        np.testing.assert_array_equal(
            reduced(picture, Crop(10, 4, 24, 16), size), cv2.resize(part, size[::-1], interpolation=cv2.INTER_LINEAR)
        )
    np.testing.assert_array_equal(reduced(picture, Crop(10, 4, 24, 16), (16, 24)), part)


def test_what_is_no_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "crops.csv")
    for path in (tmp_path / "crops.csv", Path("/dev/zero"), tmp_path):
        with pytest.raises(ArtifactError, match=r"not a regular file|Is a directory"):
            read_crops(path, [])


def test_a_row_that_is_a_link_to_itself_matches_no_video(table, tmp_path):
    (tmp_path / "loop.mp4").symlink_to("loop.mp4")
    crops, others = table(HEAD, "a.mp4,1,2,3,4", "loop.mp4,1,1,1,1", f"{'x' * 300}.mp4,1,1,1,1", only=[0])
    assert crops == [(1, 2, 3, 4)] and others == ["loop.mp4", f"{'x' * 300}.mp4"]
