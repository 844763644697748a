"""What robomimic and Minari look for beside the frames, in files that are written here."""

from __future__ import annotations

import json

import h5py
import numpy as np
import pytest

from stages.datasets.export import Export
from stages.datasets.hdf5_writing import write_minari, write_robomimic

N, T = 2, 4
ORIGIN = {"from": "ifo export-demos x", "demos": "x.demos.h5", "dataset_id": "x-v0"}


@pytest.fixture
def export():
    frames = np.random.default_rng(0).integers(0, 256, (N, T, 8, 9, 3), dtype=np.uint8)
    times = np.arange(T) / 5
    return Export((N, T, 8, 9), lambda: ((video, times) for video in frames), "camera", "push", 5, False, 12, ORIGIN)


def test_robomimic_says_where_its_demonstrations_come_from(export, tmp_path):
    write_robomimic(tmp_path / "x.hdf5", export)
    with h5py.File(tmp_path / "x.hdf5") as file:
        assert json.loads(file["data"].attrs["origin"]) == ORIGIN


def test_a_minari_episode_has_one_step_less_than_frames(export, tmp_path):
    write_minari(tmp_path, export)
    with h5py.File(tmp_path / "data" / "main_data.hdf5") as file:
        assert [dict(file[f"episode_{k}"].attrs) for k in range(N)] == [
            {"id": k, "total_steps": T - 1} for k in range(N)
        ]
    metadata = json.loads((tmp_path / "data" / "metadata.json").read_text())
    assert (metadata["total_episodes"], metadata["total_steps"]) == (N, N * (T - 1))
