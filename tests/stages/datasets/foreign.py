"""Small data sets as LeRobot and robomimic write them, made here without ifo's own writers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import h5py
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from tests.stages.videos import picture

FPS = 10
SIZE = (48, 64)
FRONT = "observation.images.front"


def number(episode: int, frame: int) -> int:
    """What a frame shows."""
    return (20 * episode + frame) % 64


def shown(episode: int, frame: int) -> np.ndarray:
    return picture(number(episode, frame), *SIZE)


def lerobot(
    path: Path,
    lengths: Sequence[int] = (9, 5, 7),
    cameras: Sequence[str] = ("observation.images.front",),
    *,
    video: bool = True,
    codec: str = "libx264",
    per_file: int = 2,
    drift: float = 0.0,
    row_groups: bool = True,
    info: dict | None = None,
) -> Path:
    """A LeRobotDataset v3 of episodes with these lengths.

    Args:
        cameras: All show the same; the first one's name is the one to take.
        per_file: Episodes in a file, and files in a chunk.
        drift: Seconds that each time stamp in the table of episodes is off.
        row_groups: A group of rows an episode, as new versions write; else one a file.
        info: What info.json says otherwise.
    """
    starts = np.concatenate([[0], np.cumsum(lengths)]).tolist()
    rows = []
    for first in range(0, len(lengths), per_file):
        episodes = list(range(first, min(first + per_file, len(lengths))))
        chunk, file = divmod(first // per_file, per_file)
        name = f"chunk-{chunk:03d}/file-{file:03d}"
        _write_table(path / f"data/{name}.parquet", episodes, lengths, starts, () if video else cameras, row_groups)
        if video:
            for camera in cameras:
                _write_video(path / f"videos/{camera}/{name}.mp4", episodes, lengths, codec)
        for episode in episodes:
            begin = (starts[episode] - starts[first]) / FPS
            rows.append(
                {
                    "episode_index": episode,
                    "tasks": ["pick"],
                    "length": lengths[episode],
                    "data/chunk_index": chunk,
                    "data/file_index": file,
                    "dataset_from_index": starts[episode],
                    "dataset_to_index": starts[episode + 1],
                }
            )
            for camera in cameras if video else ():
                rows[-1] |= {
                    f"videos/{camera}/chunk_index": chunk,
                    f"videos/{camera}/file_index": file,
                    f"videos/{camera}/from_timestamp": begin + drift,
                    f"videos/{camera}/to_timestamp": begin + lengths[episode] / FPS + drift,
                }
    write_episodes(path, rows)
    feature = {"dtype": "video" if video else "image", "shape": [*SIZE, 3], "names": ["height", "width", "channels"]}
    told = {
        "codebase_version": "v3.0",
        "robot_type": "so101_follower",
        "total_episodes": len(lengths),
        "total_frames": starts[-1],
        "total_tasks": 1,
        "chunks_size": per_file,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": FPS,
        "splits": {"train": f"0:{len(lengths)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4" if video else None,
        "features": {
            "action": {"dtype": "float32", "shape": [6], "names": None},
            **{camera: feature for camera in cameras},
            "observation.images.depth": {**feature, "shape": [*SIZE, 1], "info": {"video.is_depth_map": True}},
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        },
    }
    (path / "meta/info.json").write_text(json.dumps(told | (info or {})))
    return path


def write_episodes(path: Path, rows: Sequence[dict]) -> None:
    """meta/episodes in two files."""
    for k, part in enumerate((rows[: len(rows) // 2], rows[len(rows) // 2 :])):
        file = path / f"meta/episodes/chunk-000/file-{k:03d}.parquet"
        file.parent.mkdir(parents=True, exist_ok=True)
        pyarrow.parquet.write_table(pyarrow.Table.from_pylist(list(part)), file)


def edit_info(path, **changes):
    file = path / "meta/info.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


def edit_episodes(path, change):
    for file in (path / "meta/episodes").rglob("*.parquet"):
        rows = pyarrow.parquet.read_table(file).to_pylist()
        for row in rows:
            change(row)
        pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), file)


def _write_table(file, episodes, lengths, starts, cameras, row_groups) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    tables = []
    for episode in episodes:
        frames = range(lengths[episode])
        columns = {
            "action": [[0.0] * 6 for _ in frames],
            "timestamp": pyarrow.array([k / FPS for k in frames], "float32"),
            "frame_index": list(frames),
            "episode_index": [episode for _ in frames],
            "index": [starts[episode] + k for k in frames],
            "task_index": [0 for _ in frames],
        }
        for camera in cameras:
            pngs = [cv2.imencode(".png", shown(episode, k)[..., ::-1])[1].tobytes() for k in frames]
            columns[camera] = [{"bytes": png, "path": f"frame-{k:06d}.png"} for k, png in enumerate(pngs)]
        tables.append(pyarrow.table(columns))
    with pyarrow.parquet.ParquetWriter(file, tables[0].schema) as writer:
        for table in tables if row_groups else [pyarrow.concat_tables(tables)]:
            writer.write_table(table)


def _write_video(file, episodes, lengths, codec) -> None:
    if not _encoder_takes(codec):
        pytest.skip(f"{codec} of PyAV {av.__version__} does not encode pictures of {SIZE}")
    file.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(file), "w") as container:
        stream = container.add_stream(codec, rate=FPS)
        (stream.height, stream.width), stream.pix_fmt = SIZE, "yuv420p"
        stream.options = {"g": "2", "crf": "12", **({"preset": "8"} if codec == "libsvtav1" else {})}
        for episode in episodes:
            for k in range(lengths[episode]):
                container.mux(stream.encode(av.VideoFrame.from_ndarray(shown(episode, k), format="rgb24")))
        container.mux(stream.encode())


def _encoder_takes(codec: str) -> bool:
    """Whether this PyAV's encoder takes pictures of SIZE: SVT-AV1 of PyAV 14 needs 64 rows."""
    context = av.CodecContext.create(codec, "w")
    (context.height, context.width), context.pix_fmt, context.time_base = SIZE, "yuv420p", Fraction(1, FPS)
    try:
        context.open()
    except av.error.FFmpegError:
        return False
    return True


def robomimic(path: Path, lengths: Sequence[int] = (9, 5, 7), cameras: Sequence[str] = ("agentview_image",)) -> Path:
    """robomimic's HDF5, with low-dimensional observations and depth beside the cameras."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["total"] = sum(lengths)
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "type": 1, "env_kwargs": {"control_freq": 20}})
        for episode, length in enumerate(lengths):
            demo = data.create_group(f"demo_{episode}")
            demo.attrs["num_samples"] = length
            demo["actions"] = np.zeros((length, 7))
            frames = np.stack([shown(episode, k) for k in range(length)])
            for camera in cameras:
                demo.create_dataset(f"obs/{camera}", data=frames, compression="gzip")
                demo[f"next_obs/{camera}"] = frames
            demo["obs/agentview_depth"] = np.zeros((length, *SIZE, 1), np.float32)
            demo["obs/robot0_eef_pos"] = np.zeros((length, 3))
        file["mask/train"] = np.array([b"demo_0"])
    return path
