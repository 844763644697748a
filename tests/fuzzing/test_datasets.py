"""Targets: LeRobot datasets by careless or hostile authors."""

from __future__ import annotations

import json
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
from hypothesis import strategies as st

from artifacts import IfoError
from stages.datasets.lerobot import read_lerobot
from tests.fuzzing.places import place
from tests.fuzzing.targets import handled, numbers, target, texts
from tests.fuzzing.test_artifacts import changed, changes
from tests.stages.datasets.foreign import FRONT, lerobot

LENGTHS = (4, 3, 5)
EPISODES, TABLE = "meta/episodes/chunk-000/file-000.parquet", "data/chunk-000/file-000.parquet"


@cache
def dataset(name: str, *, video: bool) -> Path:
    """Return a dataset of three episodes in files in memory, for one target."""
    return lerobot(place(name) / "set", LENGTHS, video=video, per_file=3)


def use(path: Path, camera: str = "") -> None:
    """Do what import-demos does with each episode."""
    episodes = handled(read_lerobot, path, camera)
    if isinstance(episodes, IfoError):
        return
    for episode in episodes[:6]:
        footage = handled(episode.open)
        assert len(episode.sha256()) == 64
        if isinstance(footage, IfoError):
            continue
        times = footage.times
        assert np.isfinite(times).all() and (np.diff(times) > 0).all() and np.isfinite(footage.duration)
        if len(times):
            indices = np.unique([0, len(times) // 2, len(times) - 1])
            pictures = handled(lambda: list(footage.pictures(indices)))  # noqa: B023
            if not isinstance(pictures, IfoError):
                assert len(pictures) == len(indices)
                assert all(picture.dtype == np.uint8 and picture.shape[2] == 3 for _, picture in pictures)


def told(path: Path) -> Any:
    kept = path / "info.kept"
    if not kept.exists():
        shutil.copy(path / "meta/info.json", kept)
    return json.loads(kept.read_text())


@target("LeRobot info files", edits=changes, video=st.booleans(), camera=st.just("") | texts)
def test_info_files(edits: list[tuple[int, Any]], video: bool, camera: str) -> None:
    path = dataset(f"info-{video}", video=video)
    info = changed(told(path), edits)
    (path / "meta/info.json").write_text(json.dumps(info))
    use(path, camera)


@target("LeRobot info files, any text", data=st.binary(max_size=80))
def test_info_files_of_any_text(data: bytes) -> None:
    path = dataset("info-text", video=False)
    (path / "meta/info.json").write_bytes(data)
    use(path)


columns = st.sampled_from(
    (
        "episode_index", "length", "data/chunk_index", "data/file_index", "dataset_from_index", "dataset_to_index",
        "frame_index", "timestamp", "index", f"videos/{FRONT}/chunk_index", f"videos/{FRONT}/file_index",
        f"videos/{FRONT}/from_timestamp", f"videos/{FRONT}/to_timestamp", FRONT,
    )
)  # fmt: skip
edits_of_tables = st.lists(
    st.tuples(
        columns, st.one_of(st.just("delete"), st.just("type"), st.tuples(st.integers(0, 20), numbers | st.none()))
    ),
    min_size=1,
    max_size=4,
)


def edited(table: Any, edits: list[tuple[str, Any]]) -> Any:
    """Return a table with some columns missing, of another type, or with other values."""
    for name, edit in edits:
        if name not in table.column_names:
            continue
        at = table.column_names.index(name)
        values = table.column(name).to_pylist()
        if edit == "delete":
            table = table.remove_column(at)
        elif edit == "type":
            table = table.set_column(at, name, pyarrow.array([str(value) for value in values]))
        else:
            values[edit[0] % len(values)] = edit[1]
            try:
                table = table.set_column(at, name, pyarrow.array(values))
            except (pyarrow.ArrowException, TypeError, ValueError, OverflowError):
                continue
    return table


@target("LeRobot tables", episodes=edits_of_tables, rows=edits_of_tables, video=st.booleans(), order=st.randoms())
def test_tables(episodes: list[tuple[str, Any]], rows: list[tuple[str, Any]], video: bool, order: Any) -> None:
    path = dataset(f"tables-{video}", video=video)
    for name, edits in ((EPISODES, episodes), (TABLE, rows)):
        kept = path / f"{Path(name).parts[0]}.kept"
        if not kept.exists():
            shutil.copy(path / name, kept)
        table = edited(pyarrow.parquet.read_table(kept), edits)
        if edits[0][0] == "index":
            table = table.take(order.sample(range(len(table)), len(table)))
        pyarrow.parquet.write_table(table, path / name)
    use(path)
