"""A contact sheet of first frames with the crop drawn on each."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from artifacts import caption, tile_videos
from stages.footage.crops import Crop

CELL = (180, 240)  # height and width of an image on the sheet, pixels
LONGEST = 34  # maximum number of characters of a name
GROUND = 128  # gray level behind images whose shape differs from the cell's
LINES = (((255, 255, 255), 5), ((220, 0, 0), 2))  # color and width: red with a white outline, visible on any image


def preview_cell(picture: np.ndarray, crop: Crop, name: str) -> np.ndarray:
    """Scale an image (H, W, 3) to a cell, with the crop drawn on it and its name above."""
    import cv2

    height, width = picture.shape[:2]
    scale = min(CELL[0] / height, CELL[1] / width)
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    small = cv2.resize(np.ascontiguousarray(picture), size, interpolation=cv2.INTER_AREA)
    far = 2 * max(CELL)  # out-of-sight end of a crop that extends beyond the image

    def at(x: int, y: int) -> tuple[int, int]:
        return round(min(x * scale, far)), round(min(y * scale, far))

    corner = at(crop.x, crop.y)
    opposite = tuple(place - 1 for place in at(crop.x + crop.w, crop.y + crop.h))
    for colour, line in LINES:
        cv2.rectangle(small, corner, opposite, colour, line)
    cell = np.full((*CELL, 3), GROUND, np.uint8)
    top, left = (CELL[0] - size[1]) // 2, (CELL[1] - size[0]) // 2
    cell[top : top + size[1], left : left + size[0]] = small
    shown = name if len(name) <= LONGEST else f"...{name[3 - LONGEST :]}"
    return np.concatenate([caption([shown], [CELL[1]]), cell])


def preview_sheet(cells: Sequence[np.ndarray]) -> np.ndarray:
    """Arrange cells in a grid that is about as wide as it is high."""
    columns = math.ceil(math.sqrt(len(cells)))
    rows = [list(cells[k : k + columns]) for k in range(0, len(cells), columns)]
    return tile_videos(rows, gap=6, scale=1)[0]
