"""Writes demonstrations as robomimic and Minari HDF5. Frames are stored losslessly."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from artifacts.hdf5 import chunk_shape, new_file, room_for
from stages.datasets import minari, robomimic
from stages.datasets.export import Export

ROOM = 16 * 1024  # bytes per demonstration for groups and attributes
MINARI_VERSION = "0.5.4"  # the first version that reads images other than JPEGs
UNKNOWN = np.float32("nan")  # an action or a reward that was not recorded


def write_robomimic(path: Path, export: Export) -> None:
    """Write the file: the T frames as observations, and the other arrays that robomimic requires.

    Actions are a single NaN per step, because zeros could be mistaken for real actions.

    Args:
        path: The file, which must not exist.
        export: The demonstrations and metadata.
    """
    count, length = export.shape[:2]
    with _new_file(path, export) as file:
        data = file.create_group("data")
        data.attrs["total"] = count * length
        environment = {"env_name": export.task, "env_type": 2, "type": 2, "env_kwargs": {"control_freq": export.fps}}
        data.attrs["env_args"] = json.dumps(environment)
        data.attrs["origin"] = json.dumps(export.origin)
        for k, (frames, times) in enumerate(export.videos()):
            demo = data.create_group(f"demo_{k}")
            demo.attrs["num_samples"] = length
            _write(demo, f"obs/{export.camera}_image", frames)
            _write(demo, "actions", np.full((length, 1), UNKNOWN))
            _write(demo, "rewards", np.full(length, UNKNOWN))
            _write(demo, "dones", np.arange(length) == length - 1)
            _write(demo, robomimic.TIMES, times)


def write_minari(path: Path, export: Export) -> None:
    """Write the folder. T observations make T - 1 steps, with actions of size 0 and NaN rewards.

    Args:
        path: An existing, empty folder.
        export: The demonstrations and metadata.
    """
    count, length, height, width = export.shape
    folder = path / "data"
    folder.mkdir()
    with _new_file(folder / minari.MAIN, export) as file:
        for k, (frames, times) in enumerate(export.videos()):
            episode = file.create_group(f"episode_{k}")
            episode.attrs["id"] = k
            episode.attrs["total_steps"] = length - 1
            _write(episode, minari.OBSERVATIONS, frames)
            _write(episode, "actions", np.empty((length - 1, 0), np.float32))
            _write(episode, "rewards", np.full(length - 1, UNKNOWN, np.float64))
            _write(episode, "terminations", np.zeros(length - 1, bool))
            _write(episode, "truncations", np.arange(1, length) == length - 1)
            _write(episode, minari.TIMES, times)
    pictures = {"type": "Box", "dtype": "uint8", "shape": [height, width, 3]}
    bounds = {
        "low": np.zeros((height, width, 3), int).tolist(),
        "high": np.full((height, width, 3), 255).tolist(),
    }
    actions = {"type": "Box", "dtype": "float32", "shape": [0], "low": [], "high": []}
    metadata = {
        "total_episodes": count,
        "total_steps": count * (length - 1),
        "data_format": "hdf5",
        "jpeg_encoding": False,
        "observation_space": json.dumps(pictures | bounds),
        "action_space": json.dumps(actions),
        "dataset_id": export.origin["dataset_id"],
        "minari_version": MINARI_VERSION,
        "description": f"{export.task}: videos, without actions and rewards. {export.origin['from']}",
        "author": [],
        "author_email": [],
        "dataset_size": round((folder / minari.MAIN).stat().st_size / 1e6, 1),
    }
    (folder / minari.METADATA).write_text(json.dumps(metadata), encoding="utf-8")


@contextmanager
def _new_file(path: Path, export: Export) -> Iterator[Any]:
    count, length, height, width = export.shape
    one: dict[str, np.ndarray] = {
        "frames": np.empty((length, height, width, 3), np.uint8),
        "others": np.empty((length, 8)),
    }
    with new_file(path, count * (room_for(one, {}) - room_for({}, {}) + ROOM) + room_for({}, {})) as file:
        yield file


def _write(group: Any, name: str, array: np.ndarray) -> None:
    packed = {"compression": "gzip", "fletcher32": True} if array.ndim == 4 else {}
    chunks = chunk_shape(array.shape, array.dtype.itemsize) if packed else None
    group.create_dataset(name, data=array, chunks=chunks, **packed)
