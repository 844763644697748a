"""Compares what a video file claims to contain with the bytes that it has, before FFmpeg opens it."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from artifacts import ArtifactError, open_regular

INSIDE = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"moof", b"traf")  # MP4 boxes that contain boxes
MOST_BOXES = 10**6  # in an MP4; reading so many takes seconds
PER_SAMPLE = 0xF00  # flags of a trun box for values that it stores for every frame
SIZES = (  # of FLV and ASF: leading bytes, a mark in the header, and the form of the size of the file after it
    (b"FLV", b"\0\x08filesize\0", ">d"),
    (b"\x30\x26\xb2\x75", bytes.fromhex("a1dcab8c47a9cf118ee400c00c205365"), "<24xQ"),
)
BLOCKS, SYNC = (188, 192, 204), 0x47  # bytes in a block of a transport stream, and its first one
LONGEST_SEARCH = 2**16  # bytes
EBML, SEGMENT = b"\x1a\x45\xdf\xa3", b"\x18\x53\x80\x67"


def check_claims(path: Path) -> None:
    """Raise ArtifactError if an MP4 claims more frames than bytes: FFmpeg would allocate memory for each of them."""
    with open_regular(path) as file:
        length = os.fstat(file.fileno()).st_size
        for number, (kind, begin, end) in enumerate(_boxes(file, 0, length)):
            if number == MOST_BOXES:
                raise ArtifactError(f"{path}: has more than {MOST_BOXES} boxes: get the file again")
            claimed = 0
            if kind == b"stsz" and end - begin >= 12:
                size, claimed = struct.unpack(">II", _read(file, begin + 4, 8))
                claimed = claimed if size else 0  # Otherwise the size of each frame is stored.
            elif kind == b"trun" and end - begin >= 8:
                flags, claimed = struct.unpack(">II", _read(file, begin, 8))
                claimed = 0 if flags & PER_SAMPLE else claimed
            if claimed > length:
                raise ArtifactError(f"{path}: claims {claimed} frames in {length} bytes: get the file again")


def lacks_bytes(path: Path) -> bool:
    """Whether the file ends before its container does. False where the container does not record its size."""
    length = path.stat().st_size
    with open(path, "rb") as file:
        head = _read(file, 0, 12)
        if head.startswith(EBML):
            return _matroska_end(file) > length
        for start, mark, form in SIZES:
            if head.startswith(start):
                rest = _read(file, 0, 2**12).partition(mark)[2]
                return len(rest) >= struct.calcsize(form) and bool(struct.unpack_from(form, rest)[0] > length)
        if head.startswith(b"RIFF"):
            return 8 + struct.unpack("<I", head[4:8])[0] > length
        return any(end > length for kind, _, end in _boxes(file, 0, length) if kind in (b"mdat", b"moof"))


def has_trailer(path: Path) -> bool:
    """Whether a GIF has its trailer. Its header does not record the length."""
    with open(path, "rb") as file:
        file.seek(max(path.stat().st_size - 64, 0))
        return file.read().rstrip(b"\0\r\n ").endswith(b";")


def loses_sync(path: Path) -> bool:
    """Whether a transport stream has something else between its blocks. FFmpeg skips to the next block silently."""
    data = np.memmap(path, np.uint8, "r")
    for stride in BLOCKS:
        begin = _sync_after(data, 0, stride)
        if begin is not None:
            wrong = np.flatnonzero(data[begin::stride] != SYNC)
            return len(wrong) > 0 and _sync_after(data, begin + int(wrong[0]) * stride, stride) is not None
    return False


def _sync_after(data: np.ndarray, begin: int, stride: int) -> int | None:
    """Where five blocks follow each other, as far after `begin` as FFmpeg looks."""
    window = data[begin : begin + LONGEST_SEARCH + 5 * stride]
    count = max(len(window) - 4 * stride, 0)
    found = np.flatnonzero(np.all([window[k * stride :][:count] == SYNC for k in range(5)], axis=0))
    return begin + int(found[0]) if len(found) else None


def _read(file: BinaryIO, at: int, count: int) -> bytes:
    file.seek(at)
    return file.read(count)


def _boxes(file: BinaryIO, begin: int, end: int, depth: int = 0) -> Iterator[tuple[bytes, int, int]]:
    """Yield type, beginning and end of the content of MP4 boxes, recursively; nothing for other containers."""
    while begin + 8 <= end:
        size, kind = struct.unpack(">I4s", _read(file, begin, 8))
        header = 8
        if size == 1 and len(long := _read(file, begin + 8, 8)) == 8:
            size, header = struct.unpack(">Q", long)[0], 16
        size = size or end - begin  # 0: up to the end of the file
        if size < header or not kind.isascii():
            return
        yield kind, begin + header, begin + size
        if kind in INSIDE and depth < len(INSIDE):
            yield from _boxes(file, begin + header, min(begin + size, end), depth + 1)
        begin += size


def _matroska_end(file: BinaryIO) -> int:
    """Where the segment ends, in bytes; 0 if its size is unknown, as in a live recording."""
    at = 4
    for ident in (b"", SEGMENT):
        if _read(file, at, len(ident)) != ident:
            return 0
        at += len(ident)
        first = _read(file, at, 1)
        width = 9 - first[0].bit_length() if first and first[0] else 0
        data = _read(file, at, width)
        if not width or len(data) < width:
            return 0
        size = int.from_bytes(data, "big") & ((1 << 7 * width) - 1)
        at += width + size
    return 0 if size == (1 << 7 * width) - 1 else at
