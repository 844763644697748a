"""Writes demonstrations as a LeRobotDataset v3: one camera, with PNGs in the tables or videos of many episodes.

The dataset has no actions and no robot states: code that reads only images can use it, behavior cloning cannot.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import PlatformError
from stages.datasets import feature_statistics, parquet
from stages.datasets.export import Export
from stages.datasets.lerobot import DATA_PATH, EPISODES, INFO, VIDEO_PATH
from stages.datasets.lerobot_video_writer import VIDEO_BYTES, VideoFiles, png

DATA_BYTES = 100 * 10**6  # approximate size of a table
CHUNK = 1000  # files per folder
PREFIX = "observation.images."
EPISODES_PATH = f"{EPISODES}/chunk-000/file-000.parquet"
NUMBERS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}


def write_lerobot(path: Path, export: Export) -> None:
    """Write the dataset.

    Args:
        path: An existing, empty folder.
        export: The demonstrations and metadata.

    Raises:
        PlatformError: pyarrow is not installed, or cannot write to this path.
    """
    pyarrow = parquet.arrow()
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise PlatformError(
            "--format lerobot: pyarrow can only write to paths in UTF-8: choose another --out"
        ) from error
    count, length = export.shape[:2]
    key = PREFIX + export.camera
    levels = np.zeros((3, feature_statistics.LEVELS), np.int64)
    episodes: dict[str, list[Any]] = defaultdict(list)
    with ExitStack() as stack:
        tables = stack.enter_context(_Tables(path, "" if export.video else key))
        videos = stack.enter_context(VideoFiles(path, key, export)) if export.video else None
        for k, (frames, _) in enumerate(export.videos()):
            numbers = _numbers(k, length, export.fps)
            within = feature_statistics.levels_in(frames)
            levels += within
            place = tables.add(numbers, frames)
            row: dict[str, Any] = {
                "episode_index": k,
                "tasks": [export.task],
                "length": length,
                "data/chunk_index": place[0],
                "data/file_index": place[1],
                "dataset_from_index": k * length,
                "dataset_to_index": (k + 1) * length,
                **(videos.add(frames) if videos else {}),
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
            }
            told = {name: feature_statistics.of_numbers(values) for name, values in numbers.items()}
            told[key] = feature_statistics.of_pictures(within, length)
            for feature, figures in told.items():
                row |= {f"stats/{feature}/{name}": value for name, value in figures.items()}
            for name, value in row.items():
                episodes[name].append(value)
    (path / EPISODES_PATH).parent.mkdir(parents=True)
    pyarrow.parquet.write_table(pyarrow.table(dict(episodes)), path / EPISODES_PATH)
    _write_tasks(path / "meta" / "tasks.parquet", export.task)
    _write_json(path / INFO, _info(export, key))
    whole = {name: np.tile(values, count) for name, values in _numbers(0, length, export.fps).items()}
    whole |= {"episode_index": np.repeat(np.arange(count), length), "index": np.arange(count * length)}
    stats = {name: feature_statistics.of_numbers(values) for name, values in whole.items()}
    _write_json(path / "meta" / "stats.json", {key: feature_statistics.of_pictures(levels, count * length), **stats})
    _write_json(path / "meta" / "ifo.json", export.origin)


def _numbers(episode: int, length: int, fps: int) -> dict[str, np.ndarray]:
    """The numeric columns of an episode, (T,) each."""
    frame = np.arange(length)
    columns = {
        "timestamp": frame / fps,
        "frame_index": frame,
        "episode_index": np.full(length, episode),
        "index": episode * length + frame,
        "task_index": np.zeros(length),
    }
    return {name: columns[name].astype(dtype) for name, dtype in NUMBERS.items()}


class _Tables:
    """Writer of the data tables: one row group per episode, and a new file when one is full."""

    def __init__(self, path: Path, key: str) -> None:
        """Prepare the schema. `key` names the image column; empty if images are stored in videos."""
        self._path, self._key = path, key
        self._index = -1
        self._writer: Any = None
        self._file = path
        pyarrow = parquet.arrow()
        fields = [pyarrow.field(name, dtype) for name, dtype in NUMBERS.items()]
        described: dict[str, Any] = {name: {"dtype": dtype, "_type": "Value"} for name, dtype in NUMBERS.items()}
        if key:
            picture = pyarrow.struct([("bytes", pyarrow.binary()), ("path", pyarrow.string())])
            fields.insert(0, pyarrow.field(key, picture))
            described = {key: {"_type": "Image"}, **described}
        # Hugging Face datasets reads the column types from here.
        self._schema = pyarrow.schema(fields, {"huggingface": json.dumps({"info": {"features": described}})})

    def __enter__(self) -> _Tables:
        return self

    def __exit__(self, *_: object) -> None:
        if self._writer is not None:
            self._writer.close()

    def add(self, numbers: Mapping[str, np.ndarray], frames: np.ndarray) -> tuple[int, int]:
        """Write an episode's rows; return the chunk index and the file index."""
        pyarrow = parquet.arrow()
        if self._writer is None or self._file.stat().st_size >= DATA_BYTES:
            self.__exit__()
            self._index += 1
            self._file = self._path / DATA_PATH.format(**at(self._index))
            self._file.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pyarrow.parquet.ParquetWriter(self._file, self._schema, compression="snappy")
        columns: dict[str, Any] = dict(numbers)
        if self._key:
            columns[self._key] = [{"bytes": png(frame), "path": f"frame-{k:06d}.png"} for k, frame in enumerate(frames)]
        self._writer.write_table(pyarrow.table(columns, schema=self._schema))
        return self._index // CHUNK, self._index % CHUNK


def at(index: int) -> dict[str, int]:
    """The path template's fields for the file with this index."""
    return {"chunk_index": index // CHUNK, "file_index": index % CHUNK}


def _info(export: Export, key: str) -> dict[str, Any]:
    count, length, height, width = export.shape
    camera: dict[str, Any] = {
        "dtype": "video" if export.video else "image",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
    }
    if export.video:
        camera["info"] = {
            "video.height": height,
            "video.width": width,
            "video.codec": "h264",
            "video.pix_fmt": "yuv420p",
            "video.fps": export.fps,
            "video.channels": 3,
            "has_audio": False,
            "is_depth_map": False,
        }
    return {
        "codebase_version": "v3.0",
        "fps": export.fps,
        "features": {
            key: camera,
            **{name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in NUMBERS.items()},
        },
        "total_episodes": count,
        "total_frames": count * length,
        "total_tasks": 1,
        "chunks_size": CHUNK,
        "data_files_size_in_mb": DATA_BYTES // 10**6,
        "video_files_size_in_mb": VIDEO_BYTES // 10**6,
        "data_path": DATA_PATH,
        "video_path": VIDEO_PATH if export.video else None,
        "robot_type": None,
        "splits": {"train": f"0:{count}"},
    }


def _write_tasks(path: Path, task: str) -> None:
    """Write the table of tasks as pandas would, indexed by the task description, because LeRobot looks it up there."""
    pyarrow = parquet.arrow()
    described = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            _column("task_index", "int64", "int64"),
            _column("task", "unicode", "object"),
        ],
        "pandas_version": "2.2.0",
    }
    schema = pyarrow.schema([("task_index", "int64"), ("task", "string")], {"pandas": json.dumps(described)})
    pyarrow.parquet.write_table(pyarrow.table({"task_index": [0], "task": [task]}, schema=schema), path)


def _column(name: str, kind: str, numpy_type: str) -> dict[str, Any]:
    return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy_type, "metadata": None}


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")
