"""LeRobotDataset v3: meta/info.json lists features and paths, meta/episodes where each episode begins and ends."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import ArtifactError
from stages.datasets import parquet
from stages.datasets.episode import Episode, brief, check_is_there, choose_camera, is_plain
from stages.datasets.lerobot_paths import DATA_PATH, EPISODES, INFO, VIDEO_PATH, Listed, Template
from stages.datasets.lerobot_tables import Tables, picture_files, stored_frames
from stages.datasets.lerobot_videos import Videos
from stages.footage.footage import Footage
from stages.footage.sources import natural_order

MAJOR = 3
MOST_BYTES = 8 * 2**20  # maximum size of info.json
LARGEST_NUMBER = 2**53  # of an episode, a file or a row
CONVERTER = "python -m lerobot.scripts.convert_dataset_v21_to_v30"
OLD_EPISODES = "meta/episodes.jsonl"
TABLE_COLUMNS = ("data/chunk_index", "data/file_index", "dataset_from_index", "dataset_to_index")
VIDEO_COLUMNS = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")


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
    camera = choose_camera(path, [key for key, feature in features.items() if _is_camera(feature)], wanted)
    if not is_plain(camera):
        raise ArtifactError(f"{path / INFO}: has a feature named {brief(repr(camera))}: expected a printable name")
    files = [file for file in (path / EPISODES).glob("*/*.parquet")]
    if not files:
        if (path / OLD_EPISODES).exists():
            raise ArtifactError(f"{path}: is a LeRobot dataset of version 2: convert it with {CONVERTER}")
        raise ArtifactError(f"{path}: has no tables in {EPISODES}: download the whole dataset")
    files.sort(key=lambda file: (natural_order(file.parent), natural_order(file)))
    as_video, notes = _as_video(path, info, camera, files[0])
    templates = (
        _template(path, info, "data_path", DATA_PATH, camera),
        _template(path, info, "video_path", VIDEO_PATH, camera),
    )
    listed, doubtful = _listed(path, files, camera, as_video, *templates)
    if not listed:
        raise ArtifactError(f"{path}: has no episodes: expected at least one in {EPISODES}")
    total = _whole_number(info.get("total_episodes"))
    if total > len(listed):
        notes.append(f"{EPISODES} lacks some of the {total} episodes that {INFO} declares")
    elif 0 < total < len(listed):
        notes.append(f"{INFO} declares {total} episodes, but {EPISODES} lists {len(listed)}, which are read")
    tables = Tables(templates[0], _whole_number(info.get("total_frames")))
    videos = Videos(templates[1], listed, tables)
    fps = _number(info.get("fps"))
    digests: dict[Path, str] = {}

    def open_one(one: Listed) -> Footage:
        if one.number in doubtful:
            raise ArtifactError(f"{one.label}: is listed more than once in {EPISODES}: download the dataset again")
        if as_video:
            return videos.window(one, notes)
        return stored_frames(path, tables, one, camera, fps, notes)

    return [
        Episode(
            path,
            part=f"episode {one.number}",
            camera=camera,
            inside=(path / INFO, *files, *filter(None, [one.video if as_video else one.table])),
            opener=partial(open_one, one),
            pictures=tuple if as_video else partial(picture_files, path, tables, one, camera),
            digests=digests,
        )
        for one in listed
    ]


def _info(path: Path) -> dict[str, Any]:
    """Read and check meta/info.json."""
    file = path / INFO
    check_is_there(file)
    try:
        if file.stat().st_size > MOST_BYTES:
            raise ValueError("too large")
        info: dict[str, Any] = json.loads(file.read_bytes())
        features = info["features"]
        version = re.fullmatch(r"v?(\d{1,4})(\.\d+)*", str(info["codebase_version"]))
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise ArtifactError(
            f"{file}: is not a LeRobot info file: expected JSON with codebase_version and features"
        ) from error
    told = brief(info["codebase_version"])
    if version is None or int(version[1]) > MAJOR:
        raise ArtifactError(f"{path}: is a LeRobot dataset of version {told}: expected v{MAJOR}")
    if int(version[1]) < MAJOR:
        raise ArtifactError(
            f"{path}: is a LeRobot dataset of version {told}, expected v{MAJOR}: convert it with {CONVERTER}"
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


def _as_video(path: Path, info: Mapping[str, Any], camera: str, file: Path) -> tuple[bool, list[str]]:
    """Whether images are stored in videos rather than in tables, and remarks. The table of episodes decides."""
    declared = info["features"][camera]["dtype"] == "video"
    located = {f"videos/{camera}/{name}" for name in VIDEO_COLUMNS} <= set(parquet.names_in(file))
    if located == declared:
        return declared, []
    data = next(iter(_template(path, info, "data_path", DATA_PATH, camera).files()), None)
    in_tables = data is not None and camera in parquet.names_in(data)
    if located == in_tables:
        return declared, []
    places = "tables", "videos"
    note = f"{INFO} declares that {camera} is stored in {places[declared]}, but it is stored in {places[located]}"
    return located, [note]


def _template(path: Path, info: Mapping[str, Any], key: str, default: str, camera: str) -> Template:
    text = info.get(key)
    return Template(path, text if isinstance(text, str) and text else default, camera)


def _listed(
    path: Path, files: Sequence[Path], camera: str, as_video: bool, data: Template, video: Template
) -> tuple[list[Listed], set[int]]:
    """The episodes in order of their numbers, and the numbers of those that are listed twice with different values."""
    videos = [f"videos/{camera}/{name}" for name in VIDEO_COLUMNS]
    required, optional = (videos, TABLE_COLUMNS) if as_video else (TABLE_COLUMNS[:2], TABLE_COLUMNS[2:])
    found: dict[int, Listed] = {}
    doubtful = set()
    for file in files:
        table = parquet.columns(file, ["episode_index", *required], [*optional, "length"])
        count = len(table["episode_index"])
        nothing = np.full(count, np.nan)
        for k in range(count):
            number, chunk, number_of_file, first, last, length, *place = (
                float(table.get(name, nothing)[k])
                for name in ("episode_index", *TABLE_COLUMNS, "length", *(videos if as_video else ()))
            )
            if not number.is_integer() or abs(number) > LARGEST_NUMBER:
                raise ArtifactError(f"{file}: has an episode without a number: download the file again")
            one = Listed(
                label=f"{path}, episode {int(number)}",
                number=int(number),
                table=_place(data, chunk, number_of_file),
                video=_place(video, *place[:2]) if as_video else None,
                begin=place[2] if as_video else math.nan,
                end=place[3] if as_video else math.nan,
                length=_whole_number(length),
                span=_whole_number(last - first),
            )
            if repr(found.setdefault(one.number, one)) != repr(one):  # NaN differs from itself.
                doubtful.add(one.number)
    return [found[number] for number in sorted(found)], doubtful


def _place(template: Template, chunk: float, file: float) -> Path | None:
    """The file with these indices; None if they are not recorded."""
    if not (chunk.is_integer() and file.is_integer() and max(abs(chunk), abs(file)) < LARGEST_NUMBER):
        return None
    return template.at(int(chunk), int(file))


def _number(value: Any) -> float:
    """A positive finite number, also one written as text; 0 for anything else."""
    try:
        number = float(value) if isinstance(value, int | float | str) else 0.0
    except (ValueError, OverflowError):
        return 0.0
    return number if 0 < number < math.inf else 0.0


def _whole_number(value: Any) -> int:
    """A positive whole number; 0 for anything else."""
    number = _number(value)
    return int(number) if number.is_integer() and number < LARGEST_NUMBER else 0
