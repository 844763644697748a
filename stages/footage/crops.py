"""Crop rectangles of videos, in pixels of the image as a player displays it."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from artifacts import ArtifactError, open_regular
from stages.config.demonstrations import Crop
from stages.footage.sources import Source

MOST_BYTES = 4 * 2**20
COLUMNS = ("video", "x", "y", "w", "h")


def read_crops(path: Path, sources: Sequence[Source]) -> tuple[list[Crop], list[str]]:
    """Read the crop of every source from a CSV with columns video, x, y, w, h; also return names without a source.

    A name is a path relative to the CSV's folder, or a bare file name. A dataset's row applies to all its episodes.

    Raises:
        ArtifactError: The file cannot be read, or a video has no row or more than one.
    """
    rows: dict[str, Crop] = {}
    try:
        with open_regular(path) as file:
            data = file.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise ArtifactError(f"{path}: is larger than {MOST_BYTES // 2**20} MB: expected a CSV of crops")
        with io.StringIO(data.decode("utf-8-sig"), newline="") as text:
            reader = csv.DictReader(text, skipinitialspace=True)
            if missing := [name for name in COLUMNS if name not in (reader.fieldnames or ())]:
                raise ArtifactError(f"{path}: has no column {missing[0]!r}: expected {','.join(COLUMNS)} in line 1")
            for row in reader:
                crop = Crop.of([row[name] or "" for name in COLUMNS[1:]])
                if crop is None:
                    raise ArtifactError(f"{path}, line {reader.line_num}: expected x,y,w,h in whole pixels")
                if not row["video"] or "\0" in row["video"]:
                    raise ArtifactError(f"{path}, line {reader.line_num}: expected the name of a video")
                if rows.setdefault(row["video"], crop) is not crop:
                    raise ArtifactError(f"{path}, line {reader.line_num}: second row for {row['video']}: keep only one")
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): expected a CSV of crops") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise ArtifactError(f"{path}: is not a UTF-8 CSV file: expected a CSV of crops") from error
    places = {os.path.realpath(path.parent / name): name for name in rows}
    names = [places.get(os.path.realpath(source.path), source.path.name) for source in sources]
    absent = list({str(source.path): None for source, name in zip(sources, names, strict=True) if name not in rows})
    if absent:
        others = f", nor for {len(absent) - 1} others" if len(absent) > 1 else ""
        raise ArtifactError(f"{path}: has no row for {absent[0]}{others}: add one with {','.join(COLUMNS)}")
    return [rows[name] for name in names], sorted(set(rows) - set(names))


def centred_crop(picture: tuple[int, int], size: tuple[int, int]) -> Crop:
    """The largest centered rectangle of an image (height, width) with the aspect ratio of `size` (height, width)."""
    scale = min(picture[0] / size[0], picture[1] / size[1])
    h, w = max(round(size[0] * scale), 1), max(round(size[1] * scale), 1)
    return Crop((picture[1] - w) // 2, (picture[0] - h) // 2, w, h)


def check_crop(crop: Crop, picture: tuple[int, int], label: str) -> None:
    """Raise ArtifactError if the crop extends beyond the image (height, width)."""
    if crop.x + crop.w > picture[1] or crop.y + crop.h > picture[0]:
        raise ArtifactError(
            f"{label}: the crop {','.join(map(str, crop))} extends beyond its image of {picture[1]}x{picture[0]} "
            "pixels: check it with --preview"
        )


def reduced(picture: np.ndarray, crop: Crop, size: tuple[int, int]) -> np.ndarray:
    """Crop an image (H, W, 3), uint8, and resize it to `size` (height, width): area averaging, or linear upscaling."""
    import cv2

    part = np.ascontiguousarray(picture[crop.y : crop.y + crop.h, crop.x : crop.x + crop.w])
    shrinks = crop.h >= size[0] and crop.w >= size[1]
    return cv2.resize(part, size[::-1], interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
