"""Frames of any pixel format and with any tags are shown with the colors that a player gives them."""

from __future__ import annotations

import av
import numpy as np
import pytest

import stages.footage.display as display_module
from artifacts import ArtifactError
from stages.footage.display import Display
from stages.footage.video import VideoFile
from tests.stages.videos import picture, write_video

FORMATS = [
    "yuv420p",
    "yuvj420p",
    "nv12",
    "p010le",
    "yuva444p",
    "gbrp",
    "gray",
    "gray10le",
    "ya8",
    "rgb48le",
    "rgb555le",
]


def frame(format="yuv420p", size=(64, 64), **tags):
    """A frame of the picture with number 5."""
    if {"color_trc", "color_primaries"} & tags.keys() and not hasattr(av.VideoFrame, "color_trc"):
        pytest.skip("frames have no such tags before PyAV 17")
    made = av.VideoFrame.from_ndarray(picture(5, *size), format="rgb24").reformat(format=format)
    for name, value in tags.items():
        setattr(made, name, value)
    return made


@pytest.mark.parametrize("format", FORMATS)
def test_any_tags_can_be_shown(format):
    for matrix in (0, 1, 2, 3, 6, 8, 9, 10, 14, 200):
        for full in (0, 1, 2):
            assert Display(1).image(frame(format, colorspace=matrix, color_range=full)).shape == (64, 64, 3)


@pytest.mark.parametrize("size", [(48, 64), (576, 720), (578, 720), (480, 1280)])
@pytest.mark.parametrize("matrix", [2, 3])
def test_video_without_color_information_is_read_as_players_do(size, matrix):
    display, made = Display(1), frame(size=size, colorspace=matrix)
    shown = display.image(made)
    hd = size[0] > 576 or size[1] >= 1280
    made.colorspace = 1 if hd else 6
    np.testing.assert_array_equal(shown, made.to_ndarray(format="rgb24"))
    assert display.notes == (["HD without color information is read as BT.709, as players do"] if hd else [])
    display.image(made)
    assert len(display.notes) == hd


def test_rgb_has_no_matrix():
    display = Display(1)
    np.testing.assert_array_equal(display.image(frame("gbrp", (578, 720), colorspace=2)), picture(5, 578, 720))
    assert not display.notes


@pytest.mark.parametrize("error", [TypeError("unexpected keyword"), OSError(95, "Operation not supported")])
@pytest.mark.parametrize(
    ("tags", "name"),
    [({"color_trc": 16}, "HDR (PQ)"), ({"color_trc": 18}, "HDR (HLG)"), ({"color_primaries": 9}, "wide")],
)
def test_hdr_that_cannot_be_converted_is_told_of(tags, name, error, monkeypatch):
    class Old:
        def reformat(self, *words, **options):
            assert options["dst_color_primaries"] == 1 and options["dst_color_trc"] == (1 if name == "wide" else 13)
            raise error

    monkeypatch.setattr(display_module, "_reformatter", Old)
    display, made = Display(1), frame(**tags)
    np.testing.assert_array_equal(display.image(made), frame().to_ndarray(format="rgb24"))
    [note] = display.notes
    assert note.startswith(name) and "is not converted and looks pale" in note


def test_tags_of_the_stream_stand_in_for_those_of_frames():
    """PyAV before 17."""

    class Frame:
        width = height = 64
        colorspace, format, interlaced_frame, side_data = 9, None, False, {}

        def reformat(self, **options):
            return frame()

    display = Display(1, 16, 9)
    display._in_rgb(Frame(), 64)
    assert display.notes and display.notes[0].startswith("HDR (PQ)")


def test_hdr_keeps_its_own_transfer_where_it_is_not_hdr(monkeypatch):
    asked = []

    class Spy:
        def reformat(self, made, **options):
            asked.append(options["dst_color_trc"])
            return made.reformat(format="rgb24")

    monkeypatch.setattr(display_module, "_reformatter", Spy)
    for transfer in (2, 14, 16):
        display = Display(1)
        display.image(frame(color_primaries=9, color_trc=transfer))
        assert display.notes == [
            f"{'HDR (PQ)' if transfer == 16 else 'wide-gamut video'} is converted to SDR in BT.709"
        ]
    assert asked == [1, 14, 13]


@pytest.mark.parametrize(("aspect", "width"), [(2, 128), (0.5, 32), (1, 64), (100, 64), (0.001, 64)])
def test_pixels_are_made_square(aspect, width):
    assert Display(aspect).image(frame()).shape == (64, width, 3)


def test_colors_that_cannot_be_converted_are_named(tmp_path, monkeypatch):
    video = VideoFile(write_video(tmp_path / "x.mp4"))
    monkeypatch.setattr(Display, "_in_rgb", lambda *_: (_ for _ in ()).throw(ValueError("unsupported")))
    with pytest.raises(ArtifactError, match=r"x\.mp4: its colors \(yuv420p\) cannot be converted"):
        next(video.pictures(np.array([0])))


def test_a_stretched_image_must_not_be_too_large(tmp_path, monkeypatch):
    monkeypatch.setattr("stages.footage.container.LARGEST", 100)
    assert VideoFile(write_video(tmp_path / "x.mp4", size=(48, 64)))
    with pytest.raises(ArtifactError, match=r"wide\.mp4: its image has 128x48 pixels"):
        VideoFile(write_video(tmp_path / "wide.mp4", size=(48, 128), stretch=2))
