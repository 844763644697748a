"""A folder of images as a video."""

from __future__ import annotations

import re
from collections.abc import Generator, Sequence
from pathlib import Path

import numpy as np

from artifacts import ArtifactError, image_size, open_regular
from stages.footage.container import MOST_PIXELS, check_size

RATE = 25  # images per second
MOST_BYTES = 2**28  # of an image
PNG, JPEG = b"\x89PNG", b"\xff\xd8"  # leading bytes
JPEG_MARK = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])")  # not those within compressed data


class ImageFolder:
    """Images as frames at 25 per second, in natural order of their names, rotated according to their EXIF data.

    Attributes:
        label: The folder, as named in messages.
        times: Timestamps (F,), seconds.
        duration: Seconds, including the last frame's duration.
        cut: Always empty: missing images of a folder cannot be detected.
        damage: Always empty: damaged images are refused.
        rotation: Always 0: the decoder rotates images itself.
        notes: Remarks for the user.
    """

    def __init__(self, path: Path, images: Sequence[Path]) -> None:
        self.label, self._images = str(path), images
        self.times = np.arange(len(self._images)) / RATE
        self.duration = len(self._images) / RATE
        self.cut, self.damage, self.rotation = "", "", 0
        self.notes: list[str] = []

    def pictures(self, indices: np.ndarray) -> Generator[tuple[float, np.ndarray], None, None]:
        """Yield time and image (H, W, 3), RGB, uint8, of the frames at these increasing indices.

        Raises:
            ArtifactError: An image is damaged or has an implausible size.
        """
        for index in indices:
            yield float(self.times[index]), _read(self._images[index])


def _read(path: Path) -> np.ndarray:
    try:
        with open_regular(path) as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    if size := image_size(data):
        check_size(str(path), *size)
    image = decoded(data) if len(data) <= MOST_BYTES else None
    if image is None:
        raise ArtifactError(f"{path}: is not a complete PNG or JPEG: replace it, or remove it from the folder")
    return image


def decoded(data: bytes) -> np.ndarray | None:
    """Decode a PNG or JPEG to an image (H, W, 3), RGB, uint8.

    Returns:
        None if the data is neither, is incomplete, or is larger than `MOST_PIXELS`.
    """
    import cv2

    width, height = image_size(data) or (0, 0)
    whole = 0 < width * height <= MOST_PIXELS and _is_complete(data)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if whole else None
    except cv2.error:
        image = None
    return None if image is None else image[..., ::-1]


def _is_complete(data: bytes) -> bool:
    """Whether a PNG or JPEG goes on to its end mark: the decoder fills the missing part of a JPEG with gray.

    What follows the end mark is not part of the image: phones append a video.
    """
    at = len(PNG) + 4
    while data.startswith(PNG) and at + 8 <= len(data):
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at += 12 + int.from_bytes(data[at : at + 4], "big")
    at = len(JPEG)
    while data.startswith(JPEG) and (mark := JPEG_MARK.search(data, at)):
        if mark[1] == b"\xd9":
            return True
        at = mark.end() + int.from_bytes(data[mark.end() : mark.end() + 2], "big")
    return False
