"""A survey of folders: the artifacts in them at a glance, and what else is there. Nothing in them can stop it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from artifacts.errors import ArtifactError
from artifacts.glance import Glance, glance
from artifacts.paths import real

ENDING = ".h5"
TENSORBOARD = ".tensorboard"
TEMPORARY = re.compile(r"\..+\.tmp-[a-z0-9_]{8}")  # names of the temporary folders of `artifacts.atomic`
FRAMES = "frames"  # the dataset of demonstrations whose shape a survey reads


@dataclass(frozen=True)
class Problem:
    """A file named like an artifact, or a folder, that cannot be read, and why, in one line without its name.

    Attributes:
      foreign: Whether it is certainly no artifact, and not one that is damaged.
    """

    path: Path
    reason: str
    foreign: bool = False


@dataclass
class Survey:
    """What is in folders.

    Attributes:
      folders: The folders and files that were searched, as they were named.
      artifacts: Every artifact, checkpoints included, by path. Several paths may lead to one file.
      links: The paths of `artifacts` that are symbolic links.
      problems: What cannot be read.
      files: The other regular files, without links.
      temporary: Temporary folders of atomic writing; they are not searched.
      tensorboard: Folders of TensorBoard scalars; they are not searched.
    """

    folders: list[Path]
    artifacts: list[Glance] = field(default_factory=list)
    links: set[Path] = field(default_factory=set)
    problems: list[Problem] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    temporary: list[Path] = field(default_factory=list)
    tensorboard: list[Path] = field(default_factory=list)


def survey(folders: Sequence[str | Path]) -> Survey:
    """Search folders and their subfolders; links to folders are not followed, except where they are named themselves.

    A path that is named and leads to a file counts as found.

    Raises:
      ArtifactError: A named path does not exist or is a folder that cannot be read.
    """
    found = Survey([Path(folder) for folder in folders])
    seen: set[str] = set()
    for folder in found.folders:
        if os.path.isdir(folder):
            _search(folder, found, seen)
        elif os.path.lexists(folder):
            _look(folder, os.path.islink(folder), found)
        else:
            raise ArtifactError(f"{folder}: no such folder: name the folders that hold artifacts")
    for paths in (found.files, found.temporary, found.tensorboard):
        paths.sort()
    found.artifacts.sort(key=lambda item: item.path)
    found.problems.sort(key=lambda item: item.path)
    return found


def _search(folder: Path, found: Survey, seen: set[str]) -> None:
    """Add what is in a folder and its subfolders, except for folders in `seen`."""
    waiting = [folder]
    while waiting:
        current = waiting.pop()
        place = os.path.realpath(current)
        if place in seen:
            continue
        seen.add(place)
        try:
            entries = list(_entries(current))
        except OSError as error:
            reason = f"cannot be read ({error.strerror}): check its permissions"
            if current == folder:
                raise ArtifactError(f"{current}: {reason}") from error
            found.problems.append(Problem(current, reason))
            continue
        for entry in entries:
            path = Path(entry.path)
            if entry.is_dir(follow_symlinks=False):
                if TEMPORARY.fullmatch(entry.name):
                    found.temporary.append(path)
                elif entry.name.endswith(TENSORBOARD):
                    found.tensorboard.append(path)
                else:
                    waiting.append(path)
            elif entry.name.endswith(ENDING) and not os.path.isdir(entry.path):
                _look(path, entry.is_symlink(), found)
            elif entry.is_file(follow_symlinks=False):
                found.files.append(path)


def _entries(folder: Path) -> Iterator[os.DirEntry[str]]:
    with os.scandir(folder) as entries:
        yield from entries


def _look(path: Path, is_link: bool, found: Survey) -> None:
    try:
        found.artifacts.append(glance(path, (FRAMES,)))
    except ArtifactError as error:
        reason = str(error).removeprefix(str(path)).removeprefix(":").strip()
        found.problems.append(Problem(path, reason, foreign="not an ifo artifact" in reason))
    else:
        if is_link:
            found.links.add(path)


def distinct(found: Survey) -> list[Glance]:
    """Return the artifacts, each file once: by its own path where that was found, otherwise by its first link."""
    chosen: dict[Path, Glance] = {}
    for item in sorted(found.artifacts, key=lambda item: (item.path in found.links, item.path)):
        chosen.setdefault(real(item.path), item)
    return sorted(chosen.values(), key=lambda item: item.path)
