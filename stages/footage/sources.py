"""What counts as a video: a file, or a folder of images."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from artifacts import ArtifactError, sha256_of
from stages.footage.footage import Footage
from stages.footage.images import ImageFolder
from stages.footage.video import VideoFile

VIDEOS = (".mp4", ".m4v", ".mov", ".avi", ".webm", ".mkv", ".gif", ".mpg", ".mpeg", ".ts", ".mts", ".3gp", ".wmv")
IMAGES = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class Source:
    """A video before it is opened.

    Attributes:
        path: The file, the folder of images, or the data set, as the user named it.
        images: The folder's images in natural order of their names; empty for a file.
        part: What the data set calls this episode; empty for a file or a folder.
        camera: The data set's camera that filmed it; empty for a file or a folder.
    """

    path: Path
    images: tuple[Path, ...] = ()
    part: str = ""
    camera: str = ""

    @property
    def label(self) -> str:
        """How messages and the artifact name it."""
        return f"{self.path}, {self.part}" if self.part else str(self.path)

    @property
    def files(self) -> tuple[Path, ...]:
        """What it lies in."""
        return self.images or (self.path,)

    def open(self) -> Footage:
        """Its time stamps and pictures.

        Raises:
            ArtifactError: It cannot be read.
        """
        return ImageFolder(self.path, self.images) if self.images else VideoFile(self.path)

    def sha256(self) -> str:
        """Of the file; for a folder of images, of the names and digests of all, in their order."""
        if not self.images:
            return sha256_of(self.path)
        digest = hashlib.sha256()
        for image in self.images:
            digest.update(f"{image.name}\0{sha256_of(image)}\n".encode("utf-8", "surrogateescape"))
        return digest.hexdigest()


def natural_order(path: Path) -> tuple[list[str | int], str]:
    """Sorting key of a file's name: take2 comes before take10."""
    words = re.split(r"(\d+)", path.name.lower())
    return [int(word) if k % 2 else word for k, word in enumerate(words)], path.name


def find_videos(path: Path) -> list[Source]:
    """The video that `path` is; in a folder the videos directly in it, or else its images as one video.

    Raises:
        ArtifactError: There is no such file, or the folder holds neither videos nor images.
    """
    try:
        if not path.is_dir():
            if not path.exists():
                raise ArtifactError(f"{path}: no such file: expected a video, or a folder of videos or images")
            if not path.is_file():
                raise ArtifactError(f"{path}: is no ordinary file: expected a video, or a folder of videos or images")
            return [Source(path)]
        # A link to nothing is a file that cannot be read, which is said where it is opened.
        files = sorted((file for file in path.iterdir() if file.is_file() or not file.exists()), key=natural_order)
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    files = [file for file in files if not file.name.startswith(".")]
    if videos := _of(files, VIDEOS):
        return [Source(video) for video in videos]
    if images := _of(files, IMAGES):
        return [Source(path, tuple(images))]
    raise ArtifactError(f"{path}: holds no video and no image directly in it: name the folder that does")


def _of(files: Sequence[Path], suffixes: tuple[str, ...]) -> list[Path]:
    return [file for file in files if file.suffix.lower() in suffixes]
