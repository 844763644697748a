"""LeRobotDataset v3: meta/info.json lists features and paths, meta/episodes where each episode begins and ends."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import ArtifactError
from stages.datasets import parquet
from stages.datasets.episode import Episode, check_is_there, choose_camera
from stages.datasets.frames import StoredFrames, from_bytes, times_of
from stages.datasets.window import VideoWindow
from stages.footage.footage import Footage
from stages.footage.sources import natural_order
from stages.footage.video import VideoFile

MAJOR = 3
INFO = "meta/info.json"
EPISODES = "meta/episodes"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
MOST_BYTES = 64 * 2**20  # maximum size of info.json
FIELD = re.compile(r"\{(\w+)(?::0?(\d{1,2})d)?\}")
CONVERTER = "python -m lerobot.scripts.convert_dataset_v21_to_v30"


@dataclass
class LeRobotSet:
    """Metadata of a dataset.

    Attributes:
        path: The dataset's folder.
        fps: Frames per second; 0 if not recorded.
        camera: The camera to import.
        as_video: Whether images are stored in videos rather than in the tables.
        template: Path of the image files relative to the folder, with fields in braces.
        notes: Remarks for the user.
        digests: See `Episode`.
    """

    path: Path
    fps: float
    camera: str
    as_video: bool
    template: str
    notes: list[str] = field(default_factory=list)
    digests: dict[Path, str] = field(default_factory=dict)
    _video: tuple[Path, VideoFile] | None = None

    def columns(self) -> list[str]:
        """The columns of meta/episodes that locate an episode: chunk and file, beginning and end."""
        if self.as_video:
            kinds = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")
            return [f"videos/{self.camera}/{kind}" for kind in kinds]
        return ["data/chunk_index", "data/file_index", "dataset_from_index", "dataset_to_index"]

    def video(self, path: Path) -> VideoFile:
        """The opened video file. The last one is cached because consecutive episodes share a file."""
        if self._video is None or self._video[0] != path:
            check_is_there(path)
            self._video = path, VideoFile(path)
        return self._video[1]


def read_lerobot(path: Path, wanted: str) -> list[Episode]:
    """Return the episodes in order of their index.

    Args:
        path: The folder.
        wanted: The value of --camera.

    Raises:
        ArtifactError: The dataset is damaged, has another version, or contains no images.
        UsageError: The camera is ambiguous or unknown.
        PlatformError: pyarrow is not installed.
    """
    parquet.arrow()
    info = _info(path)
    features = info["features"]
    cameras = [key for key, feature in features.items() if _is_camera(feature)]
    camera = choose_camera(path, cameras, wanted)
    as_video = features[camera]["dtype"] == "video"
    template = info.get("video_path" if as_video else "data_path") or (VIDEO_PATH if as_video else DATA_PATH)
    fps = info.get("fps")
    fps = float(fps) if isinstance(fps, int | float) and 0 < fps < float("inf") else 0.0
    found = LeRobotSet(path, fps, camera, as_video, str(template))
    episodes = _episodes(found)
    total = info.get("total_episodes")
    if isinstance(total, int) and total > len(episodes):
        found.notes.append(f"{EPISODES} lacks some of the {total} episodes that {INFO} declares")
    return episodes


def _info(path: Path) -> dict[str, Any]:
    """Read and check meta/info.json."""
    file = path / INFO
    check_is_there(file)
    try:
        if file.stat().st_size > MOST_BYTES:
            raise ValueError("too large")
        info: dict[str, Any] = json.loads(file.read_bytes())
        features = info["features"]
        version = re.fullmatch(r"v?(\d+)(\.\d+)*", str(info["codebase_version"]))
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise ArtifactError(
            f"{file}: is not a LeRobot info file: expected JSON with codebase_version and features"
        ) from error
    if version is None or int(version[1]) > MAJOR:
        raise ArtifactError(f"{path}: is a LeRobot dataset of version {info['codebase_version']}: expected v{MAJOR}")
    if int(version[1]) < MAJOR:
        raise ArtifactError(
            f"{path}: is a LeRobot dataset of version {info['codebase_version']}, expected v{MAJOR}: convert it with "
            f"{CONVERTER}"
        )
    if not isinstance(features, dict):
        raise ArtifactError(f"{file}: has no table of features: download the dataset again")
    return info


def _is_camera(feature: Any) -> bool:
    """Whether a feature holds camera images. Depth maps do not count."""
    if not isinstance(feature, dict) or feature.get("dtype") not in ("video", "image"):
        return False
    told = [about for about in (feature.get("info"), feature.get("video_info")) if isinstance(about, dict)]
    return not any(about.get("is_depth_map") or about.get("video.is_depth_map") for about in told)


def _episodes(found: LeRobotSet) -> list[Episode]:
    files = sorted((found.path / EPISODES).glob("*/*.parquet"), key=lambda file: natural_order(file.parent / file.name))
    files.sort(key=lambda file: natural_order(file.parent))
    if not files:
        raise ArtifactError(f"{found.path}: has no tables in {EPISODES}: download the whole dataset")
    where = found.columns()
    episodes: dict[int, Episode] = {}
    for file in files:
        table = parquet.columns(file, ["episode_index", *where], ["length"])
        numbers = table["episode_index"]
        lengths = table.get("length") or [None] * len(numbers)
        for number, length, *places in zip(numbers, lengths, *(table[name] for name in where), strict=True):
            if not isinstance(number, int):
                raise ArtifactError(f"{file}: has an episode without a number: download the file again")
            known = all(isinstance(value, int | float) and np.isfinite(value) for value in places)
            place = _place(found, *map(int, places[:2])) if known else None
            label = f"{found.path}, episode {number}"
            episodes[number] = Episode(
                found.path,
                part=f"episode {number}",
                camera=found.camera,
                inside=() if place is None else (place,),
                opener=partial(_open, found, label, place, number, places[2], places[3], length),
                digests=found.digests,
            )
    return [episodes[number] for number in sorted(episodes)]


def _place(found: LeRobotSet, chunk_index: int, file_index: int) -> Path:
    """The file that the dataset's path template names. It avoids str.format, which is unsafe on untrusted templates."""
    values: dict[str, str | int] = {
        "video_key": found.camera,
        "chunk_index": chunk_index,
        "file_index": file_index,
    }
    problem = f"{found.path / INFO}: has the path {found.template!r}: expected a path like {DATA_PATH}"

    def fill(match: re.Match[str]) -> str:
        if match[1] not in values:
            raise ArtifactError(problem)
        return str(values[match[1]]).zfill(int(match[2] or 0))

    relative = Path(FIELD.sub(fill, found.template))
    if "{" in str(relative) or relative.is_absolute() or ".." in relative.parts:
        raise ArtifactError(problem)
    return found.path / relative


def _open(
    found: LeRobotSet, label: str, place: Path | None, number: int, begin: Any, end: Any, length: int | None
) -> Footage:
    if place is None:
        raise ArtifactError(f"{label}: {EPISODES} does not record where its {found.camera} is stored")
    if found.as_video:
        return VideoWindow(label, found.video(place), float(begin), float(end), length or 0, found.notes)
    names = ("episode_index", "frame_index")
    table = parquet.columns(place, names, ["timestamp"])
    rows = np.flatnonzero(np.array(table["episode_index"], float) == number)
    if not len(rows):
        raise ArtifactError(f"{label}: {place} has no rows for it: download the dataset again")
    order = np.argsort(np.array(table["frame_index"], float)[rows], kind="stable")
    if not (np.diff(order) == 1).all():
        raise ArtifactError(f"{label}: its rows in {place} are out of order: download the dataset again")
    stamps = np.array(table["timestamp"], float)[rows] if "timestamp" in table else None
    expected = int(end) - int(begin)
    cut = f"is truncated to {len(rows)} of {expected} frames" if len(rows) < expected else ""
    times, notes = times_of(stamps, len(rows), found.fps, "no frame rate is recorded; 25 frames per second are assumed")
    return StoredFrames(label, times, partial(_pictures, label, place, found.camera, rows), cut, found.notes + notes)


def _pictures(label: str, place: Path, camera: str, of_episode: np.ndarray, indices: np.ndarray) -> Any:
    for value in parquet.rows(place, camera, of_episode[indices]):
        value = value.get("bytes") if isinstance(value, dict) else value
        yield from_bytes(label, value if isinstance(value, bytes) else None)
