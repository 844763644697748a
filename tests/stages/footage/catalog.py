"""The media files that the import is compared on: codecs, pixels, orientations, track layouts, and faulty ones."""

from __future__ import annotations

from fractions import Fraction
from functools import partial

import numpy as np

from tests.stages.footage.faulty import DAMAGE, HEADERS
from tests.stages.footage.hdr import write_hdr
from tests.stages.footage.media import (
    TENTHS,
    Media,
    changed,
    cover_art,
    end_edit,
    oriented,
    shifted,
    two_tracks,
    video,
)
from tests.stages.videos import X265, write_video

VARIABLE = [0, 40, 80, 120, 1000, 1040, 1080, 1500, 2000, 2400, 3000]  # milliseconds
SMALL = {"size": (64, 64)}  # x265 needs this much
FAST = {"cpu-used": "8", "deadline": "realtime"}
B_FRAMES = {"bf": "3", "g": "8", "sc_threshold": "0"}


CODECS = [
    video("h264.mp4", "H.264"),
    video("h264-b.mp4", "H.264, B-frames", options=B_FRAMES),
    video(
        "h264-open.mkv", "H.264, open GOPs", options={"g": "7", "bf": "3", "x264-params": "open-gop=1:b-pyramid=normal"}
    ),
    video("h264-refresh.mkv", "H.264, intra refresh", options={"g": "10", "x264-params": "intra-refresh=1"}),
    video("h264-paff.ts", "H.264, interlaced", options={"x264-params": "tff=1"}, more={"words": "interlaced"}),
    video("h264-lossless.mkv", "H.264, lossless RGB", "libx264rgb", "rgb24", options={"qp": "0"}),
    video("hevc.mp4", "HEVC", "libx265", options=X265, **SMALL),
    video(
        "hevc-open.mp4",
        "HEVC, open GOPs",
        "libx265",
        options={"x265-params": "log-level=none:keyint=8:open-gop=1"},
        **SMALL,
    ),
    video("av1.mp4", "AV1", "libsvtav1", options={"g": "17", "preset": "8", "crf": "12"}, **SMALL),
    video("vp9.webm", "VP9", "libvpx-vp9", options=FAST),
    video(
        "vp9-hidden.webm",
        "VP9, hidden frames",
        "libvpx-vp9",
        options={"cpu-used": "4", "lag-in-frames": "12", "auto-alt-ref": "1"},
    ),
    video("vp8.webm", "VP8, hidden frames", "libvpx", options={"auto-alt-ref": "1", "lag-in-frames": "10"}),
    video("mpeg4.mp4", "MPEG-4 Part 2", "mpeg4"),
    video("mpeg4-b.avi", "MPEG-4 Part 2 in AVI, B-frames", "mpeg4", options={"bf": "2"}),
    video("mpeg2.mpg", "MPEG-2 program stream", "mpeg2video", options={"bf": "2"}, rate=25),
    video(
        "mpeg2.ts",
        "MPEG-2, interlaced",
        "mpeg2video",
        options={"flags": "+ildct+ilme", "top": "1"},
        rate=25,
        more={"words": "interlaced"},
    ),
    video("mpeg1.mpg", "MPEG-1", "mpeg1video", rate=25),
    video("mjpeg.avi", "Motion JPEG in AVI", "mjpeg", "yuvj420p"),
    video("mjpeg.mov", "Motion JPEG", "mjpeg", "yuvj422p"),
    video("prores.mov", "ProRes", "prores_ks", "yuv422p10le"),
    video("ffv1.mkv", "FFV1, RGB", "ffv1", "bgr0"),
    video("huffyuv.avi", "HuffYUV", "huffyuv", "yuv422p"),
    video("utvideo.avi", "Ut Video, RGB", "utvideo", "gbrp"),
    video("raw.avi", "raw RGB", "rawvideo", "bgr24"),
    video("png.mov", "PNGs", "png", "rgb24"),
    video("qtrle.mov", "QuickTime Animation", "qtrle", "rgb24"),
    video("wmv2.wmv", "WMV", "wmv2"),
    video("sorenson.flv", "Sorenson Spark", "flv1", rate=25),
    video("animation.gif", "GIF", "gif", "rgb8"),
]
PIXELS = [
    video("gray.mp4", "gray", pixels="gray", more={"gray": True}),
    video("ten-bit.mkv", "10 bits", pixels="yuv420p10le"),
    video("hevc-ten-bit.mov", "HEVC, 10 bits", "libx265", "yuv420p10le", options=X265, **SMALL),
    video("422.mkv", "4:2:2", pixels="yuv422p"),
    video("444.mp4", "4:4:4, odd size", pixels="yuv444p", size=(49, 63)),
    video("odd.webm", "VP9, odd size", "libvpx-vp9", size=(49, 65), options=FAST),
    video("full.mp4", "full range", full=True, tags={"color_range": 2}),
    video("bt601.mp4", "tagged BT.601", tags={"colorspace": 6}),
    video("bt709.mp4", "tagged BT.709", matrix=1, tags={"colorspace": 1}),
    video("bt709-full.mp4", "tagged BT.709, full range", matrix=1, full=True, tags={"colorspace": 1, "color_range": 2}),
    video("bt2020.mp4", "BT.2020 matrix", matrix=9, tags={"colorspace": 9}),
    video("sd.mp4", "SD without tags", size=(576, 720)),
    video(
        "hd.mp4",
        "HD without tags",
        matrix=1,
        size=(720, 1280),
        options={"preset": "ultrafast"},
        more={"words": "read as BT.709", "hd": True},
    ),
    video("hd-601.mp4", "HD tagged BT.601", size=(720, 1280), tags={"colorspace": 6}, options={"preset": "ultrafast"}),
    video("wide.mp4", "pixels twice as wide as high", stretch=2, size=(48, 96)),
    Media(
        "pq.mp4",
        "HDR10 (PQ)",
        partial(write_hdr, transfer=16),
        times=TENTHS,
        words="HDR (PQ) is converted to SDR",
        exact=False,
    ),
    Media(
        "gamut.mp4",
        "BT.2020, SDR",
        partial(write_hdr, transfer=14),
        times=TENTHS,
        words="wide-gamut video is converted to SDR",
        exact=False,
    ),
    Media(
        "hlg.mp4",
        "HLG",
        partial(write_hdr, transfer=18),
        times=TENTHS,
        words="HDR (HLG) is converted to SDR",
        exact=False,
    ),
]
ORIENTATIONS = [
    oriented("turn-90.mp4", "rotated by 90 degrees", (0, 1, -1, 0), lambda image: np.rot90(image, 1)),
    oriented("turn-180.mov", "rotated by 180 degrees", (-1, 0, 0, -1), lambda image: np.rot90(image, 2)),
    oriented("turn-270.mp4", "rotated by 270 degrees", (0, -1, 1, 0), lambda image: np.rot90(image, 3)),
    oriented("flip-h.mp4", "mirrored horizontally", (-1, 0, 0, 1), lambda image: image[:, ::-1]),
    oriented("flip-v.mp4", "mirrored vertically", (1, 0, 0, -1), lambda image: image[::-1]),
    oriented("transposed.mp4", "mirrored at the diagonal", (0, 1, 1, 0), lambda image: image.transpose(1, 0, 2)),
    oriented(
        "transversed.mp4",
        "mirrored at the other diagonal",
        (0, -1, -1, 0),
        lambda image: np.rot90(image, 2).transpose(1, 0, 2),
    ),
]
LAYOUTS = [
    video("plain.mov", "H.264 in MOV"),
    video("plain.ts", "H.264 in a transport stream", options=B_FRAMES),
    video("plain.avi", "H.264 in AVI, B-frames", options={"bf": "2"}),
    video("plain.flv", "H.264 in FLV"),
    video("plain.3gp", "H.264 in 3GP"),
    video("plain.m4v", "H.264 in M4V", container={"movflags": "+faststart"}),
    video("fragments.mp4", "fragmented MP4", options={"g": "5"}, container={"movflags": "+frag_keyframe+empty_moov"}),
    video("live.mkv", "live recording without sizes or duration", container={"live": "1"}),
    video("ntsc.mp4", "29.97 frames a second", rate=Fraction(30000, 1001)),
    video("fast.mkv", "120 frames a second, times in milliseconds", rate=120),
    Media(
        "variable.mp4",
        "variable rate",
        partial(write_video, milliseconds=VARIABLE),
        range(11),
        [k / 1000 for k in VARIABLE],
    ),
    Media(
        "variable.webm",
        "variable rate",
        partial(write_video, codec="libvpx", milliseconds=VARIABLE),
        range(11),
        [k / 1000 for k in VARIABLE],
    ),
    video("long-sound.mkv", "sound is longer", audio=4),
    video("short-sound.mp4", "sound is shorter", audio=1),
    video("later.ts", "begins at 1000 s", began=1000),
    video("delayed.mp4", "begins at 1 s, by an empty edit", began=1),
    Media(
        "trimmed.mp4", "beginning trimmed by an edit list", partial(shifted, seconds=-0.5), range(5, 25), TENTHS[:20]
    ),
    Media("end-trimmed.mp4", "end trimmed by an edit list", changed(end_edit), range(15), TENTHS[:15]),
    video("timecode.mov", "timecode track", metadata={"timecode": "01:00:00:00"}),
    Media("cover.mp4", "cover art", cover_art, times=TENTHS),
    Media(
        "first.mkv",
        "two tracks, the first is default",
        partial(two_tracks, default=0),
        times=TENTHS,
        words="of 2 video tracks, number 1",
    ),
    Media(
        "second.mp4",
        "two tracks, the second is default",
        partial(two_tracks, default=1),
        times=TENTHS,
        words="of 2 video tracks, number 2",
    ),
    Media(
        "neither.mkv",
        "two tracks, neither is default",
        partial(two_tracks, default=None),
        times=TENTHS,
        words="of 2 video tracks, number 2",
    ),
]

MEDIA = {media.name: media for media in (*CODECS, *PIXELS, *ORIENTATIONS, *LAYOUTS, *HEADERS, *DAMAGE)}
