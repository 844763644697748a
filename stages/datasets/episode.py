"""An episode of a dataset as a video source."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from artifacts import ArtifactError, UsageError, sha256_of
from stages.footage.footage import Footage
from stages.footage.sources import Source

LFS_POINTER = b"version https://git-lfs"


def _unopened() -> Footage:
    raise NotImplementedError


@dataclass(frozen=True)
class Episode(Source):
    """An episode before it is opened.

    Attributes:
        inside: The files that contain the episode, wholly or in part.
        opener: Opens the episode.
        digests: SHA-256 of the dataset's files, shared by its episodes so that each file is read once.
    """

    inside: tuple[Path, ...] = ()
    opener: Callable[[], Footage] = _unopened
    digests: dict[Path, str] = field(default_factory=dict, compare=False)

    @property
    def files(self) -> tuple[Path, ...]:
        return self.inside

    def open(self) -> Footage:
        return self.opener()

    def sha256(self) -> str:
        """SHA-256 of the episode's name and the digests of the files that contain it."""
        digest = hashlib.sha256(f"{self.part}\0{self.camera}\n".encode("utf-8", "surrogateescape"))
        for file in self.inside:
            if file not in self.digests:
                self.digests[file] = sha256_of(file)
            digest.update(f"{self.digests[file]}\n".encode())
        return digest.hexdigest()


def episodes_in(
    file: Path, path: Path, camera: str, names: Sequence[str], open_one: Callable[[str], Footage]
) -> list[Episode]:
    """The named episodes in one file of the dataset at `path`; `open_one` opens an episode by name."""
    digests: dict[Path, str] = {}
    return [
        Episode(path, part=name, camera=camera, inside=(file,), opener=partial(open_one, name), digests=digests)
        for name in names
    ]


def choose_camera(path: Path, cameras: Sequence[str], wanted: str) -> str:
    """Return the camera that `wanted` names, in full or by the last part of its name; if empty, the only camera.

    Raises:
        ArtifactError: The dataset has no camera.
        UsageError: The dataset has no such camera, or several and `wanted` is empty.
    """
    if not cameras:
        raise ArtifactError(f"{path}: contains no images: expected a dataset with a camera")
    if not wanted:
        if len(cameras) > 1:
            raise UsageError(f"{path}: has the cameras {', '.join(cameras)}: choose one with --camera")
        return cameras[0]
    found = [camera for camera in cameras if camera == wanted] or [
        camera for camera in cameras if wanted in (last_part(camera), last_part(camera).removesuffix("_image"))
    ]
    if len(found) != 1:
        raise UsageError(f"--camera {wanted}: {path} has no such camera: expected {', '.join(cameras)}")
    return found[0]


def last_part(camera: str) -> str:
    """The part of a camera's name after the last dot or slash."""
    return re.split(r"[./]", camera)[-1]


def check_is_there(path: Path) -> None:
    """Raise ArtifactError if a file of a dataset is missing, empty, unreadable, or was not downloaded."""
    try:
        with open(path, "rb") as file:
            start = file.read(len(LFS_POINTER))
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: no such file: download the whole dataset") from error
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    if start == LFS_POINTER:
        raise ArtifactError(f"{path}: is a Git LFS pointer instead of the file: run git lfs pull")
    if not start:
        raise ArtifactError(f"{path}: is empty: download it again")
