"""The data tables of a LeRobotDataset: which rows belong to an episode. The rows decide, not the table of episodes."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import ArtifactError
from stages.datasets import parquet
from stages.datasets.episode import is_plain
from stages.datasets.frames import StoredFrames, from_bytes, times_of
from stages.datasets.lerobot_paths import EPISODES, INFO, Listed, Template

MOST_BYTES = 256 * 2**20  # maximum size of an image file
RATE_SLACK = 0.1  # relative difference between time stamps and the frame rate that is worth a remark
UNKNOWN_RATE = "no frame rate is recorded; 25 frames per second are assumed"
OTHER_LENGTH = f"lengths in {EPISODES} disagree with the rows and frames, which decide"
OTHER_RANGE = (
    f"dataset_from_index and dataset_to_index in {EPISODES} disagree with the rows of the tables, which decide"
)
OTHER_TABLE = f"{EPISODES} names another table than the one with the rows, which is read"
OTHER_RATE = f"time stamps in the tables disagree with the frame rate in {INFO}; the time stamps are used"
NUMBERS = ("episode_index", "frame_index")
OPTIONAL = ("timestamp", "index")


@dataclass(frozen=True)
class Rows:
    """The rows of an episode, in order of their frame index.

    Attributes:
        files: The tables that contain them.
        table: Index into `files` (F,) for every row.
        row: Row number (F,) within the table.
        stamps: Timestamps (F,), seconds; None if a table has none.
        whole: Whether the rows continue the count of all rows without a gap, before, between and after them.
    """

    files: tuple[Path, ...]
    table: np.ndarray
    row: np.ndarray
    stamps: np.ndarray | None
    whole: bool

    def __len__(self) -> int:
        return len(self.row)

    def complete(self, one: Listed) -> bool:
        """Whether no row is missing. One confirmation is enough, because the numbers of `one` may be wrong."""
        return len(self) == one.length or len(self) >= one.most_rows or self.whole


class Tables:
    """The data tables. The columns of numbers of the last table are cached because consecutive episodes share one."""

    def __init__(self, template: Template, total: int) -> None:
        """Args:
        template: Path of the tables.
        total: Number of rows that the dataset declares; 0 if not recorded.
        """
        self._template = template
        self._cached: tuple[Path, dict[str, np.ndarray]] | None = None
        self._paths: tuple[Path, list[str | None]] | None = None
        self._all: list[Path] | None = None
        self._holders: dict[int, list[Path]] = {}
        self._lengths: dict[int, int] = defaultdict(int)
        self._starts = {float(total)}  # Indices that follow the last row of a table.

    def rows_of(self, one: Listed) -> Rows:
        """Find the rows of an episode: in its table, or, if some are missing there, in all tables.

        Raises:
            ArtifactError: There are no such rows, their order is unknown, or a table cannot be read.
        """
        place = one.table
        problem: ArtifactError | None = None
        try:
            rows = None if place is None else self._collect(one, [place])
        except ArtifactError as error:
            rows, problem = None, error
        if rows is None or not rows.complete(one):
            elsewhere = self._elsewhere(one)
            if elsewhere:
                rows = self._collect(one, elsewhere)
        if rows is None:
            raise problem or ArtifactError(f"{one.label}: the tables have no rows for it: download the dataset again")
        return rows

    def lengths(self) -> dict[int, int]:
        """Number of rows of every episode that a readable table contains, also of those that are listed nowhere."""
        self._scan()
        return dict(self._lengths)

    def _elsewhere(self, one: Listed) -> list[Path]:
        """All readable tables that contain rows of an episode."""
        self._scan()
        return self._holders.get(one.number, [])

    def _scan(self) -> None:
        if self._all is not None:
            return
        self._all = self._template.files()
        for file in self._all:
            try:
                columns = self._numbers(file)
            except ArtifactError:  # Reported for the episodes that it should contain.
                continue
            self._starts |= {*columns.get("index", ())[:1]}
            numbers = columns["episode_index"]
            for number, count in zip(*np.unique(numbers[np.isfinite(numbers)], return_counts=True), strict=True):
                self._holders.setdefault(int(number), []).append(file)
                self._lengths[int(number)] += int(count)

    def _numbers(self, file: Path) -> dict[str, np.ndarray]:
        if self._cached is None or self._cached[0] != file:
            self._cached = file, parquet.columns(file, NUMBERS, OPTIONAL)
        return self._cached[1]

    def paths(self, file: Path, camera: str) -> list[str | None]:
        """See `parquet.paths`. Those of the last table are cached."""
        if self._paths is None or self._paths[0] != file:
            self._paths = file, parquet.paths(file, camera)
        return self._paths[1]

    def _collect(self, one: Listed, files: list[Path]) -> Rows | None:
        found: list[tuple[int, np.ndarray, dict[str, np.ndarray]]] = []
        for k, file in enumerate(files):
            numbers = self._numbers(file)
            rows = np.flatnonzero(numbers["episode_index"] == one.number)
            if len(rows):
                found.append((k, rows, {name: column[rows] for name, column in numbers.items()}))
        if not found:
            return None
        frames = np.concatenate([columns["frame_index"] for _, _, columns in found])
        if not np.isfinite(frames).all() or len(np.unique(frames)) < len(frames):
            raise ArtifactError(
                f"{one.label}: its rows in {files[found[0][0]]} share a frame_index, or have none: download the "
                "dataset again"
            )
        order = np.argsort(frames, kind="stable")
        stamps = [columns["timestamp"] for _, _, columns in found if "timestamp" in columns]
        return Rows(
            tuple(files),
            np.concatenate([np.full(len(rows), k) for k, rows, _ in found])[order],
            np.concatenate([rows for _, rows, _ in found])[order],
            np.concatenate(stamps)[order] if len(stamps) == len(found) else None,
            self._is_whole(files[found[0][0]], found[0][1], frames) if len(found) == 1 else False,
        )

    def _is_whole(self, file: Path, rows: np.ndarray, frames: np.ndarray) -> bool:
        """Whether the column `index`, which counts all rows of the dataset, has no gap at or between these rows."""
        index = self._numbers(file).get("index")
        if index is None or index[rows[-1]] - index[rows[0]] != len(rows) - 1:
            return False
        first, last = rows[0], rows[-1]
        begins = index[first - 1] == index[first] - 1 if first else frames.min() == 0
        ends = index[last + 1] == index[last] + 1 if last + 1 < len(index) else index[last] + 1 in self._starts
        return bool(begins and ends)


def stored_frames(path: Path, tables: Tables, one: Listed, camera: str, fps: float, notes: list[str]) -> StoredFrames:
    """The images of an episode that are stored in the tables, or in files that the tables name.

    Args:
        path: The dataset's folder.
        tables: Its tables.
        one: The episode.
        camera: Name of the column.
        fps: Frames per second; 0 if not recorded.
        notes: Remarks on the dataset.

    Raises:
        ArtifactError: The rows cannot be found or read.
    """
    rows = tables.rows_of(one)
    count, cut, notes = len(rows), "", list(notes)
    if not rows.complete(one):
        cut = f"is truncated to {count} of {one.most_rows} frames"
    else:
        notes += [OTHER_LENGTH] * (one.length not in (0, count)) + [OTHER_RANGE] * (one.span not in (0, count))
    if one.table is None or set(np.array(rows.files)[rows.table]) != {one.table}:
        notes.append(OTHER_TABLE)
    times, said = times_of(rows.stamps, count, fps, UNKNOWN_RATE)
    if not said and fps and count > 1 and abs(float(np.median(np.diff(times))) * fps - 1) > RATE_SLACK:
        notes.append(OTHER_RATE)
    return StoredFrames(one.label, times, partial(_pictures, path, one, camera, rows), cut, notes + said)


def _pictures(path: Path, one: Listed, camera: str, rows: Rows, indices: np.ndarray) -> Iterator[np.ndarray]:
    table, row = rows.table[indices], rows.row[indices]
    order = np.lexsort((row, table))
    values = _values(rows.files, camera, table[order], row[order])
    if (order == np.arange(len(order))).all():
        ordered: Iterator[Any] = values
    else:  # The rows are out of order: all wanted images are in memory, still compressed.
        ordered = (value for _, value in sorted(zip(order, values, strict=True), key=lambda pair: int(pair[0])))
    for value in ordered:
        yield from_bytes(one.label, _bytes_of(path, one, camera, value))


def _values(files: tuple[Path, ...], camera: str, table: np.ndarray, row: np.ndarray) -> Iterator[Any]:
    for k in np.unique(table):
        yield from parquet.rows(files[k], camera, row[table == k])


def _bytes_of(path: Path, one: Listed, camera: str, value: Any) -> bytes | None:
    """The bytes of an image, which a table holds, or names the file of."""
    data = value.get("bytes") if isinstance(value, dict) else value
    if isinstance(data, bytes) and data:
        return data
    name = value.get("path") if isinstance(value, dict) else value
    if not isinstance(name, str):
        return None
    file = picture_file(path, one, camera, name)
    if file is None:
        raise ArtifactError(f"{one.label}: an image file of {camera} is missing: download the whole dataset")
    try:
        if file.stat().st_size > MOST_BYTES:
            raise ArtifactError(f"{file}: has more than {MOST_BYTES} bytes: expected an image")
        return file.read_bytes()
    except OSError as error:
        raise ArtifactError(f"{file}: cannot be read ({error.strerror}): check its permissions") from error


def picture_file(path: Path, one: Listed, camera: str, name: str) -> Path | None:
    """The image file that a table names; None if there is no such file.

    A name is relative to the dataset's folder, or to the folder where LeRobot records the episode's images.

    Raises:
        ArtifactError: The name, or a link that it leads to, is outside the dataset's folder.
    """
    outside = f"{one.label}: a path of {camera} leads out of the dataset, and is not followed: copy the file into it"
    relative, root = Path(name), Path(os.path.abspath(path))
    if relative.is_absolute() and relative.is_relative_to(root):
        relative = relative.relative_to(root)
    if relative.is_absolute() or ".." in relative.parts or not all(map(is_plain, relative.parts)):
        raise ArtifactError(outside)
    for folder in (path, path / "images" / camera / f"episode-{one.number:06d}"):
        file = folder / relative
        if os.path.isfile(file):  # Unlike Path.is_file, it never raises.
            if not file.resolve().is_relative_to(path.resolve()):
                raise ArtifactError(outside)
            return file
    return None


def picture_files(path: Path, tables: Tables, one: Listed, camera: str) -> list[Path]:
    """The files of an episode besides the table that it states: other tables, and the image files that they name."""
    found: list[Path] = []
    try:
        rows = tables.rows_of(one)
        for k in np.unique(rows.table):
            found += [rows.files[k]] if rows.files[k] != one.table else []
            names = tables.paths(rows.files[k], camera)
            for row in rows.row[rows.table == k] if names else ():
                name = names[row]
                file = None if name is None else picture_file(path, one, camera, name)
                if file is not None:
                    found.append(file)
    except (ArtifactError, OSError):  # Reported when the episode is opened.
        return []
    return found
