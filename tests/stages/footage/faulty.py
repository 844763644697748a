"""Media files whose headers are wrong, that begin between keyframes, or are damaged or cut."""

from __future__ import annotations

import struct
from functools import partial

from tests.stages.footage.media import (
    COUNT,
    FPS,
    PAL,
    TENTHS,
    Media,
    changed,
    damaged,
    joined,
    overwritten,
    put,
    remuxed,
    resized,
    shortened,
    unfinished,
    without_blocks,
)
from tests.stages.videos import X265, write_avi, write_sound

SMALL = {"size": (64, 64)}  # x265 needs this much
FAST = {"cpu-used": "8", "deadline": "realtime"}
GROUP = {"g": "12", "bf": "3", "sc_threshold": "0"}
DROPPED = (7, 8, 15)
KEPT = [k for k in range(COUNT) if k not in DROPPED]
BETWEEN = {"shown": range(10, COUNT), "times": TENTHS[:15], "words": "begins between keyframes", "exact": False}
OPEN = {"words": "begins between keyframes", "exact": False}
DAMAGED = {"words": "is damaged", "refused": "--strict", "times": TENTHS, "exact": False}
HEADERS = [
    Media(
        "long.mkv",
        "header says 100 s",
        changed(lambda data: put(data, b"\x44\x89\x88", 3, struct.pack(">d", 1e5))),
        times=TENTHS,
    ),
    Media(
        "short.mkv",
        "header says 0.1 s",
        changed(lambda data: put(data, b"\x44\x89\x88", 3, struct.pack(">d", 1e2))),
        times=TENTHS,
    ),
    Media(
        "untimed.webm",
        "header without duration",
        changed(lambda data: put(data, b"\x44\x89\x88", 0, b"\xec\x89"), codec="libvpx"),
        times=TENTHS,
    ),
    Media(
        "long.mp4",
        "header says ten times as long",
        changed(lambda data: put(data, b"mdhd", 20, struct.pack(">I", 10**6))),
        times=TENTHS,
    ),
    Media(
        "long.flv",
        "header says 100 s",
        changed(lambda data: put(data, b"duration\0", 9, struct.pack(">d", 100))),
        times=TENTHS,
    ),
    Media(
        "many.avi",
        "header says 60 frames",
        changed(lambda data: put(data, b"strh", 40, struct.pack("<I", 60)), codec="mjpeg", pixels="yuvj420p"),
        times=TENTHS,
    ),
    Media(
        "few.avi",
        "header says 3 frames",
        changed(lambda data: put(data, b"strh", 40, struct.pack("<I", 3)), codec="mjpeg", pixels="yuvj420p"),
        times=TENTHS,
    ),
    Media("unfinished.avi", "recorder ended without writing sizes and index", unfinished, times=TENTHS),
    Media(
        "dropped.avi",
        "dropped frames are empty chunks",
        partial(write_avi, dropped=DROPPED),
        KEPT,
        [k / FPS for k in KEPT],
    ),
    Media(
        "dropped-mpeg4.avi",
        "dropped frames, MPEG-4 Part 2",
        partial(write_avi, dropped=DROPPED, codec="mpeg4"),
        KEPT,
        [k / FPS for k in KEPT],
    ),
    Media("trailing.mp4", "followed by other bytes", changed(lambda data: data.extend(b"trailing" * 99)), times=TENTHS),
    Media("trailing.mkv", "followed by other bytes", changed(lambda data: data.extend(b"trailing" * 99)), times=TENTHS),
    Media(
        "trailing.avi",
        "followed by other bytes",
        changed(lambda data: data.extend(b"trailing" * 99), codec="mpeg4"),
        times=TENTHS,
    ),
    Media(
        "trailing.gif",
        "followed by other bytes",
        changed(lambda data: data.extend(b"trailing" * 99), codec="gif", pixels="rgb8"),
        times=TENTHS,
    ),
    Media(
        "unended.gif", "end mark missing", changed(lambda data: data.pop(), codec="gif", pixels="rgb8"), times=TENTHS
    ),
    Media(
        "between.mkv",
        "begins between keyframes",
        remuxed(".mkv", "libx264", 4, {"g": "10", "bf": "2", "sc_threshold": "0"}),
        **BETWEEN,
    ),
    Media(
        "between.ts",
        "begins between keyframes",
        remuxed(".ts", "libx264", 4, {"g": "10", "bf": "0", "sc_threshold": "0"}),
        **BETWEEN,
    ),
    Media("between.webm", "begins between keyframes", remuxed(".webm", "libvpx", 4, {"g": "10", **FAST}), **BETWEEN),
    Media("between.avi", "begins between keyframes", remuxed(".avi", "mpeg4", 4, {"g": "10"}), **BETWEEN),
    Media(
        "between.mpg",
        "begins between keyframes",
        remuxed(".mpg", "mpeg2video", 4, {"g": "10"}, 25),
        **BETWEEN | {"times": PAL[:15]},
    ),
    Media(
        "open.mpg",
        "begins with an open GOP",
        remuxed(".mpg", "mpeg2video", None, {"g": "9", "bf": "2"}, 25),
        range(9, COUNT),
        PAL[: COUNT - 9],
        **OPEN,
    ),
    Media(
        "open.ts",
        "begins with an open GOP",
        remuxed(".ts", "libx264", None, {"g": "9", "bf": "2", "x264-params": "open-gop=1:b-adapt=0:scenecut=0"}),
        range(9, COUNT),
        TENTHS[: COUNT - 9],
        **OPEN,
    ),
]
LOST = {"words": "parts of it cannot be read", "refused": "--strict", "times": None, "exact": False}
CUT = {"times": TENTHS, "refused": "always", "exact": False}
DAMAGE = [
    Media("zeros.mp4", "zeros in the middle, B-frames", damaged(range(5, 9), options=GROUP), **DAMAGED),
    Media("zeros.mkv", "zeros in the middle, H.264", damaged(range(5, 9), options=GROUP), **DAMAGED),
    Media("zeros.ts", "188-byte blocks lost", without_blocks, **DAMAGED | {"times": TENTHS[:24]}),
    Media("zeros-mpeg4.mp4", "zeros in the middle, MPEG-4 Part 2", damaged(range(5, 7), codec="mpeg4"), **DAMAGED),
    Media(
        "zeros-mjpeg.avi",
        "zeros in the middle, Motion JPEG",
        damaged(range(5, 9), codec="mjpeg", pixels="yuvj420p"),
        **DAMAGED,
    ),
    Media("zeros-vp8.webm", "zeros in the middle, VP8", damaged(range(5, 7), codec="libvpx", options=FAST), **DAMAGED),
    Media(
        "zeros-hevc.mp4",
        "zeros in the middle, HEVC",
        damaged(range(5, 9), codec="libx265", options=X265, **SMALL),
        **DAMAGED | {"words": "cannot be decoded", "refused": "always"},
    ),
    Media(
        "zeros-av1.mp4",
        "zeros in the middle, AV1",
        damaged(range(5, 9), codec="libsvtav1", options={"g": "12", "preset": "10"}, **SMALL),
        **DAMAGED,
    ),
    Media(
        "zeros-prores.mov",
        "zeros in the middle, ProRes",
        damaged(range(5, 9), codec="prores_ks", pixels="yuv422p10le"),
        **DAMAGED | {"words": "cannot be decoded", "refused": "always"},
    ),
    Media("lost.avi", "chunks lost in the middle", overwritten(0.4, 0.5, codec="mjpeg", pixels="yuvj420p"), **LOST),
    Media(
        "lost.mkv",
        "clusters lost in the middle",
        overwritten(0.6, 0.7, container={"cluster_time_limit": "300"}),
        **LOST,
    ),
    Media("lost.ts", "blocks overwritten", overwritten(0.5, 0.6, options={"g": "50", "bf": "0"}), **LOST),
    Media("all-zeros.mp4", "all frames are zeros", damaged(range(COUNT)), words="cannot be decoded", **CUT),
    Media(
        "cut.mp4",
        "last part missing",
        shortened(0.85, container={"movflags": "+faststart"}, options={"g": "4"}),
        words="of 25 frames",
        **CUT,
    ),
    Media(
        "cut-fragments.mp4",
        "last part missing, fragmented",
        shortened(0.85, container={"movflags": "+frag_keyframe+empty_moov"}, options={"g": "4"}),
        words="truncated",
        **CUT,
    ),
    Media("cut.mkv", "last part missing", shortened(0.85), words="is truncated to", **CUT),
    Media("cut.flv", "last part missing", shortened(0.6), words="is truncated to", **CUT),
    Media("cut.wmv", "last part missing", shortened(0.6, codec="wmv2"), words="is damaged or truncated", **CUT),
    Media(
        "cut.avi", "last part missing", shortened(0.8, codec="mjpeg", pixels="yuvj420p"), words="of 25 frames", **CUT
    ),
    Media(
        "cut.gif",
        "last part missing",
        shortened(0.6, codec="gif", pixels="rgb8"),
        words="is damaged or truncated",
        **CUT,
    ),
    Media("headless.mp4", "header missing", shortened(0.5), words="is not a video, or is truncated", **CUT),
    Media("empty.mp4", "empty", lambda path: path.touch(), words="is empty", **CUT),
    Media("text.mp4", "text", lambda path: path.write_text("This is no video.\n" * 40), words="is not a video", **CUT),
    Media("sound.mp4", "only sound", write_sound, words="contains no video stream", **CUT),
    Media(
        "restarted.ts",
        "two recordings in one file",
        lambda path: joined(path, {}, {}),
        words="time stamps go back",
        **CUT,
    ),
    Media("resized.ts", "frame size changes", resized, words="image size changes midway", **CUT),
]
