"""A folder of images as a video."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from pathlib import Path

import numpy as np

from artifacts import ArtifactError
from stages.footage.video import check_size

RATE = 25  # images a second
ENDS = {b"\x89PNG": b"IEND", b"\xff\xd8": b"\xff\xd9"}  # how a PNG and a JPEG start -> what a whole one ends with


class ImageFolder:
    """Images as frames, 25 a second, in natural order of their names; turned as their EXIF data say.

    Attributes:
        label: The folder, as messages name it.
        times: Time stamps (F,), seconds.
        duration: Seconds, the last frame's included.
        cut: Empty: a folder does not tell what it lacks.
        rotation: 0: the decoder turns images itself.
        notes: What people should know.
    """

    def __init__(self, path: Path, images: Sequence[Path]) -> None:
        self.label, self._images = str(path), images
        self.times = np.arange(len(self._images)) / RATE
        self.duration = len(self._images) / RATE
        self.cut, self.rotation = "", 0
        self.notes: list[str] = []

    def pictures(self, indices: np.ndarray) -> Generator[tuple[float, np.ndarray], None, None]:
        """Time and picture (H, W, 3), RGB, uint8, of the frames at these increasing indices.

        Raises:
            ArtifactError: An image is damaged, or of an absurd size.
        """
        for index in indices:
            yield float(self.times[index]), _read(self._images[index])


def _read(path: Path) -> np.ndarray:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    image = decoded(data)
    if image is None:
        raise ArtifactError(f"{path}: is no whole PNG or JPEG: get the file again, or take it out of the folder")
    check_size(str(path), image.shape[1], image.shape[0])
    return image


def decoded(data: bytes) -> np.ndarray | None:
    """The picture (H, W, 3), RGB, uint8, that a PNG or a JPEG holds; None if it is neither, or not whole."""
    import cv2

    # Checked here, because the decoder fills up a truncated JPEG with grey.
    end = next((end for start, end in ENDS.items() if data.startswith(start)), b"")
    whole = bool(end) and data.rfind(end) >= len(data) // 2
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if whole else None
    except cv2.error:
        image = None
    return None if image is None else image[..., ::-1]
