"""Finds video sources: files and folders of images."""

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
        path: The file, the folder of images, or the dataset, as the user named it.
        images: The folder's images in natural order of their names; empty for a file.
        part: The dataset's name for this episode; empty for a file or a folder.
        camera: The dataset's camera that recorded it; empty for a file or a folder.
    """

    path: Path
    images: tuple[Path, ...] = ()
    part: str = ""
    camera: str = ""

    @property
    def label(self) -> str:
        """The name used in messages and in the artifact."""
        return f"{self.path}, {self.part}" if self.part else str(self.path)

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that contain the video."""
        return self.images or (self.path,)

    def open(self) -> Footage:
        """Open the video.

        Raises:
            ArtifactError: The video cannot be read.
        """
        return ImageFolder(self.path, self.images) if self.images else VideoFile(self.path)

    def sha256(self) -> str:
        """SHA-256 of the file; for a folder of images, of all names and digests in order."""
        if not self.images:
            return sha256_of(self.path)
        digest = hashlib.sha256()
        for image in self.images:
            digest.update(f"{image.name}\0{sha256_of(image)}\n".encode("utf-8", "surrogateescape"))
        return digest.hexdigest()


def natural_order(path: Path) -> tuple[list[str | int], str]:
    """Sort key of a file's name: take2 comes before take10."""
    words = re.split(r"(\d+)", path.name.lower())
    return [int(word) if k % 2 else word for k, word in enumerate(words)], path.name


def find_videos(path: Path) -> list[Source]:
    """Return the video at `path`; for a folder, the videos directly in it, or else its images as one video.

    Raises:
        ArtifactError: The file does not exist, or the folder contains neither videos nor images.
    """
    try:
        if not path.is_dir():
            if not path.exists():
                raise ArtifactError(f"{path}: no such file: expected a video or a folder of videos or images")
            if not path.is_file():
                raise ArtifactError(f"{path}: is not a regular file: expected a video or a folder of videos or images")
            return [Source(path)]
        # Keep broken links, pipes and devices: opening them reports that they cannot be read.
        files = sorted((file for file in path.iterdir() if not file.is_dir()), key=natural_order)
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    files = [file for file in files if not file.name.startswith(".")]
    if videos := _of(files, VIDEOS):
        return [Source(video) for video in videos]
    if images := _of(files, IMAGES):
        return [Source(path, tuple(images))]
    raise ArtifactError(f"{path}: contains no videos or images: pass the folder that directly contains them")


def _of(files: Sequence[Path], suffixes: tuple[str, ...]) -> list[Path]:
    return [file for file in files if file.suffix.lower() in suffixes]
