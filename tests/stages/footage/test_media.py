"""The media files of catalog.py are shown as they are: frames, times and colors of the source and of another decode."""

from __future__ import annotations

import shutil

import av
import numpy as np
import pytest

from tests.stages.footage.catalog import MEDIA
from tests.stages.footage.comparison import Row, as_markdown, independent_decode, measure, with_ffmpeg, with_pyav

EVERY = 8  # of so many files, one is tested fast
SLOW = {
    "pq.mp4",
    "hlg.mp4",
    "gamut.mp4",
    "hd.mp4",
    "hd-601.mp4",
    "sd.mp4",
}  # large, or HDR, whose color table takes seconds
ALWAYS = {
    "h264-open.mkv",
    "zeros.ts",
    "zeros-av1.mp4",
    "lost.ts",
    "lost.mkv",
    "open.ts",
    "restarted.ts",
}  # no other test is like them
QUICK = ALWAYS | {name for k, name in enumerate(MEDIA) if k % EVERY == 0} - SLOW


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in MEDIA]
)
def test_a_media_file_is_shown_as_it_is(name, tmp_path):
    if name == "lost.avi" and not hasattr(av.stream.Stream, "index_entries"):
        pytest.skip("this version of PyAV does not tell what an index holds")
    row = measure(MEDIA[name], tmp_path)
    assert not row.wrong, row


def test_enough_files_of_every_kind_are_compared():
    assert len(MEDIA) >= 100 and len(QUICK) >= 15
    assert len({name.rpartition(".")[2] for name in MEDIA}) >= 12
    assert sum(media.exact for media in MEDIA.values()) >= 60


@pytest.mark.skipif(not shutil.which("ffmpeg"), reason="ffmpeg is not installed")
@pytest.mark.parametrize("name", ["h264-b.mp4", "turn-90.mp4", "second.mp4"])
def test_both_independent_decodes_agree(name, tmp_path):
    path = tmp_path / name
    MEDIA[name].make(path)
    assert independent_decode() is with_ffmpeg
    for ours, theirs in zip(with_ffmpeg(path, False), with_pyav(path, False), strict=True):
        assert ours.shape == theirs.shape and np.abs(ours.astype(float) - theirs).mean() < 3


def test_the_table_says_what_failed():
    media = MEDIA["h264.mp4"]
    rows = [Row(media, 25, 25, 0.001, 1.24, 0.5), Row(media, said="a | b", wrong=["refused"])]
    lines = as_markdown(rows).splitlines()
    assert lines[-2] == "| h264.mp4 | H.264 | 25 | 25 | 1.0 | 1.2 | 0.5 |  | agrees |"
    assert lines[-1] == "| h264.mp4 | H.264 |  |  |  |  |  | a / b | WRONG: refused |"
    assert "2 files, 1 as they should be" in lines[2]
