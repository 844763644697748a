"""An episode of a dataset as a video source."""

from __future__ import annotations

import hashlib
import os
import re
import stat
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from artifacts import ArtifactError, UsageError, sha256_of
from stages.footage.footage import Footage
from stages.footage.sources import Source

LFS_POINTER = b"version https://git-lfs"
GENERIC = re.compile(r"[._/](images?|img|rgb|colou?r)$")  # endings of camera names that --camera may leave out
LONGEST = 80  # characters of a text from a file in a message
LISTED = 20  # names in a message


def _unopened() -> Footage:
    raise NotImplementedError


@dataclass(frozen=True)
class Episode(Source):
    """An episode before it is opened.

    Attributes:
        inside: The files that contain the episode, wholly or in part, and those that say where it is.
        opener: Opens the episode.
        pictures: Finds further files, for example of images that are files of their own.
        digests: SHA-256 of the dataset's files, shared by its episodes so that each file is read once.
    """

    inside: tuple[Path, ...] = ()
    opener: Callable[[], Footage] = _unopened
    pictures: Callable[[], Sequence[Path]] = tuple
    digests: dict[Path, str] = field(default_factory=dict, compare=False)

    @property
    def files(self) -> tuple[Path, ...]:
        return *self.inside, *self.pictures()

    def open(self) -> Footage:
        return self.opener()

    def sha256(self) -> str:
        """SHA-256 of the episode's name and the digests of its files; that of an unreadable file is empty."""
        digest = hashlib.sha256(f"{self.part}\0{self.camera}\n".encode("utf-8", "surrogateescape"))
        for file in self.files:
            if file not in self.digests:
                try:
                    check_is_there(file)
                    self.digests[file] = sha256_of(file)
                except (ArtifactError, OSError):  # Reported when the episode is opened, unless it is not needed.
                    self.digests[file] = ""
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
    """Return the camera that `wanted` names; if empty, the only camera.

    A camera is named in full, by the last parts of its name, or by these without an ending such as `_image` or `_rgb`.

    Raises:
        ArtifactError: The dataset has no camera.
        UsageError: The dataset has no such camera, or several and `wanted` does not tell them apart.
    """
    if not cameras:
        raise ArtifactError(f"{path}: contains no images: expected a dataset with a camera")
    if not wanted:
        if len(cameras) > 1:
            raise UsageError(f"{path}: has the cameras {listing(cameras)}: choose one with --camera")
        return cameras[0]
    if wanted in cameras:
        return wanted
    for names in (cameras, [GENERIC.sub("", camera) for camera in cameras]):
        found = [camera for camera, name in zip(cameras, names, strict=True) if _ends_with(name, wanted)]
        if len(found) > 1:
            raise UsageError(f"--camera {wanted}: {path} has the cameras {listing(found)}: give the full name")
        if found:
            return found[0]
    raise UsageError(f"--camera {wanted}: {path} has no such camera: expected {listing(cameras)}")


def _ends_with(name: str, wanted: str) -> bool:
    """Whether a name is `wanted`, or ends with it after a dot or slash."""
    return name == wanted or name.endswith((f".{wanted}", f"/{wanted}"))


def brief(text: object, longest: int = LONGEST) -> str:
    """A text from a file, fit for a message: printable, on one line, and short."""
    words = " ".join(str(text).split())
    shown = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in words[:longest])
    return shown + ("..." if len(words) > longest else "")


def reason_of(error: BaseException) -> str:
    """The message of a library's exception, fit for a message."""
    return brief(error, 200) or type(error).__name__


def listing(names: Sequence[str]) -> str:
    """Names from a file, fit for a message."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(map(brief, names[:LISTED])) + more


def is_plain(name: object) -> bool:
    """Whether a name from a file can stand in messages and paths: printable text of at most 255 bytes."""
    return isinstance(name, str) and name.isprintable() and 0 < len(name.encode()) < 256


def check_is_there(path: Path) -> None:
    """Raise ArtifactError if a file of a dataset is missing, empty, unreadable, or was not downloaded.

    A device or a named pipe is refused before it is opened, because reading it may never end.
    """
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise ArtifactError(f"{path}: cannot be read (not a regular file): download the whole dataset")
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
