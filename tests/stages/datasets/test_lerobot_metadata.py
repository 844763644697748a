"""Metadata of a LeRobotDataset that disagree with its tables and videos: the rows and the frames decide."""

from __future__ import annotations

import shutil

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from stages.datasets.lerobot import read_lerobot
from tests.stages.datasets.foreign import FPS, FRONT, edit_episodes, edit_info
from tests.stages.datasets.four_episodes import LENGTHS, TABLE, TRUE, edit_rows, taken

BEGIN, END, FILE, CHUNK = (
    f"videos/{FRONT}/{name}" for name in ("from_timestamp", "to_timestamp", "file_index", "chunk_index")
)


def drifting(row):
    """A drift that grows to 1.5 frames."""
    k = row["episode_index"]
    row.update({BEGIN: row[BEGIN] + k * 0.05, END: row[END] + (k + 1) * 0.05})


IN_VIDEOS = {
    "drift": (drifting, "found by counting frames"),
    "drift, one file": (drifting, "found by counting frames"),
    "no times": (lambda row: row.update({BEGIN: None, END: None}), "found by counting frames"),
    "times from zero": (lambda row: row.update({BEGIN: 0.0, END: row["length"] / FPS}), "found by counting frames"),
    "times backward": (lambda row: row.update({BEGIN: 9.0 - row["episode_index"]}), "found by counting frames"),
    "times of another rate": (lambda row: row.update({BEGIN: row[BEGIN] * 2, END: row[END] * 2}), "by counting frames"),
    "lengths": (lambda row: row.update(length=row["length"] + 1), "lengths in meta/episodes disagree"),
    "swapped lengths": (
        lambda row: row.update(length=LENGTHS[row["episode_index"] ^ 1]),
        "lengths in meta/episodes disagree",
    ),
    "no lengths": (lambda row: row.update(length=None), ""),
    "all in one file": (lambda row: row.update({FILE: 0}), "names another video file"),
    "last one in the file before": (lambda row: row["episode_index"] == 2 and row.update({FILE: 0}), "another video"),
    "scrambled indices": (lambda row: row.update(dataset_to_index=7, dataset_from_index=3), ""),
    "numbers are floats": (lambda row: row.update({FILE: float(row[FILE]), "length": float(row["length"])}), ""),
}


@pytest.mark.parametrize("fault", IN_VIDEOS)
def test_frames_of_videos_decide(data_set, fault):
    change, words = IN_VIDEOS[fault]
    path = data_set(per_file=4 if fault.endswith(", one file") else 2)
    edit_episodes(path, change)
    found, notes = taken(path)
    assert found == TRUE
    assert words in notes and bool(words) == bool(notes)


def test_lengths_decide_without_tables_if_the_durations_confirm_them(data_set):
    path = data_set(per_file=4)
    shutil.rmtree(path / "data")
    edit_episodes(path, drifting)
    edit_episodes(path, lambda row: row.update({END: row[BEGIN] + row["length"] / FPS}))
    assert taken(path)[0] == TRUE
    edit_episodes(path, lambda row: row.update(length=LENGTHS[row["episode_index"] ^ 1]))
    assert not any(video in TRUE for video in taken(path)[0])


def test_two_swapped_time_stamps_do_not_swap_episodes(data_set):
    """Alone, the first time stamps tell of another order, but the rows and the other time stamps agree."""
    path = data_set(per_file=4)
    swapped = {1: 2.1, 3: 0.9}
    edit_episodes(path, lambda row: row.update({BEGIN: swapped.get(row["episode_index"], row[BEGIN])}))
    found, notes = taken(path)
    assert found == TRUE and "found by counting frames" in notes


def test_times_that_fill_a_file_decide_only_without_rows(data_set):
    path = data_set(per_file=1)
    edit_episodes(path, lambda row: row.update(length=LENGTHS[row["episode_index"] ^ 1]))
    edit_episodes(path, lambda row: row["episode_index"] == 1 and row.update({CHUNK: 2, END: 0.7}))
    assert taken(path)[0] == TRUE
    edit_episodes(path, lambda row: row["episode_index"] == 1 and row.update({CHUNK: 1, END: 0.5}))
    shutil.rmtree(path / "data")
    assert taken(path)[0] == TRUE


def test_overlapping_episodes_are_refused(data_set):
    path = data_set(per_file=4)
    shutil.rmtree(path / "data")
    edit_episodes(path, lambda row: row.update(length=row["length"] * 2) if row["episode_index"] == 0 else None)
    edit_episodes(path, lambda row: row.update({END: 1.8}) if row["episode_index"] == 0 else None)
    found, _ = taken(path)
    assert "contradict the lengths" in found[0] and "contradict the lengths" in found[1] and found[2:] == TRUE[2:]


def test_rows_of_episodes_that_are_not_listed_help(data_set):
    """A deleted episode that is still in the tables and videos, and an episode in another file than the stated one."""
    path = data_set(per_file=1)
    for file in (path / "meta/episodes").rglob("*.parquet"):
        rows = [row for row in pyarrow.parquet.read_table(file).to_pylist() if row["episode_index"] != 2]
        pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), file)
    edit_episodes(path, lambda row: row["episode_index"] == 1 and row.update({CHUNK: 2}))
    assert taken(path)[0] == [*TRUE[:2], TRUE[3]]


def test_episodes_in_another_order_than_their_numbers(data_set):
    path = data_set(per_file=2)
    swap = {0: 1, 1: 0, 2: 2, 3: 3}
    edit_episodes(path, lambda row: row.update(episode_index=swap[row["episode_index"]]))
    found, notes = taken(path)
    assert found == [TRUE[1], TRUE[0], *TRUE[2:]] and not notes


def test_a_deleted_episode_leaves_a_gap(data_set):
    path = data_set(per_file=4)
    for file in (path / "meta/episodes").rglob("*.parquet"):
        rows = [row for row in pyarrow.parquet.read_table(file).to_pylist() if row["episode_index"] != 1]
        pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), file)
    assert taken(path) == (
        [TRUE[0], *TRUE[2:]],
        "meta/episodes lacks some of the 4 episodes that meta/info.json declares",
    )


def test_unclear_episodes_of_a_truncated_video_are_refused(data_set, originals):
    """With a drift and a video that lacks its end, only episodes before the first contradiction are certain."""
    path = data_set(per_file=4)
    name = f"videos/{FRONT}/chunk-000/file-000.mp4"
    shutil.copy(originals(per_file=3) / name, path / name)
    found, _ = taken(path)
    assert found[:3] == TRUE[:3] and "before" in found[3]
    edit_episodes(
        path, lambda row: row.update({BEGIN: row[BEGIN] * 1.07, END: row[BEGIN] * 1.07 + row["length"] / FPS})
    )
    found, _ = taken(path)
    assert found[0] == TRUE[0]
    assert all(isinstance(video, str) or video in TRUE for video in found) and "contradict" in found[2] + found[3]


IN_TABLES = {
    "scrambled": (lambda row: row.update(dataset_to_index=row["dataset_to_index"] + 60), "dataset_to_index in"),
    "lengths": (
        lambda row: row.update(length=row["length"] + 1, dataset_to_index=None),
        "lengths in meta/episodes disagree",
    ),
    "shorter": (lambda row: row.update(length=row["length"] - 1), "lengths in meta/episodes disagree"),
    "no lengths": (lambda row: row.update(length=None, dataset_to_index=None, dataset_from_index=None), ""),
    "other file": (lambda row: row.update({"data/file_index": 0}), "names another table"),
    "missing file": (lambda row: row.update({"data/file_index": 9}), "names another table"),
    "no file": (lambda row: row.update({"data/file_index": None}), "names another table"),
}


@pytest.mark.parametrize("fault", IN_TABLES)
def test_rows_of_tables_decide(data_set, fault):
    change, words = IN_TABLES[fault]
    path = data_set(video=False)
    edit_episodes(path, change)
    found, notes = taken(path)
    assert found == TRUE
    assert words in notes and bool(words) == bool(notes)


ROWS = {
    "backward": lambda rows: rows[::-1],
    "frames from 5": lambda rows: [row | {"frame_index": row["frame_index"] + 5} for row in rows],
    "episodes mixed": lambda rows: sorted(rows, key=lambda row: (row["frame_index"], row["episode_index"])),
    "floats": lambda rows: [row | {"episode_index": float(row["episode_index"])} for row in rows],
}


@pytest.mark.parametrize("fault", ROWS)
def test_rows_in_any_order(data_set, fault):
    path = data_set(video=False)
    edit_rows(path, ROWS[fault])
    found, notes = taken(path)
    assert found == TRUE and not notes


def test_rows_in_another_table_are_imported(ifo, numbers, data_set):
    path = data_set(video=False)
    edit_episodes(path, lambda row: row.update({"data/file_index": 9}))
    code, result, said = ifo(path)
    assert code == 0 and numbers(result["path"]) == [
        [video[0], video[(len(video) - 1) // 2], video[-1]] for video in TRUE
    ]
    assert said.count("names another table than the one with the rows, which is read (4 of 4 videos") == 1


def test_an_episode_in_two_tables(data_set):
    path = data_set(video=False)
    moved = pyarrow.parquet.read_table(path / TABLE).to_pylist()[11:]
    edit_rows(path, lambda rows: rows[:11])
    edit_rows(path, lambda rows: moved + rows, "data/chunk-000/file-001.parquet")
    found, notes = taken(path)
    assert found == TRUE and "names another table" in notes


def test_rows_that_are_missing_or_twice_are_refused(data_set):
    path = data_set(video=False)
    edit_rows(path, lambda rows: rows[3:9] + rows[9:] + rows[9:10])
    found, _ = taken(path)
    assert found[0] == "is truncated to 6 of 9 frames" and "share a frame_index" in found[1] and found[2:] == TRUE[2:]


def test_time_stamps_that_disagree_with_the_rate_are_used_and_told(data_set):
    path = data_set(video=False, per_file=4)
    edit_info(path, fps="20")
    footage = read_lerobot(path, "")[0].open()
    assert footage.times[1] == pytest.approx(1 / FPS) and "disagree with the frame rate" in footage.notes[0]
    edit_rows(path, lambda rows: [row | {"timestamp": 1.0} for row in rows])
    footage = read_lerobot(path, "")[0].open()
    assert footage.times[1] == pytest.approx(1 / 20) and "replaced by equal steps" in footage.notes[0]


@pytest.mark.parametrize("fps", ["10", 10.0, "10.0", None, [], {}, float("nan"), -3, 10**400, True, "x"])
def test_rates_and_totals_of_any_type(data_set, fps):
    path = data_set(video=False, per_file=4)
    edit_info(path, fps=fps, total_episodes=fps, total_frames=fps)
    assert taken(path)[0] == TRUE


def test_totals_that_are_too_small_are_told(data_set):
    path = data_set(per_file=4)
    edit_info(path, total_episodes=2)
    assert taken(path) == (TRUE, "meta/info.json declares 2 episodes, but meta/episodes lists 4, which are read")


def test_an_episode_that_is_listed_twice(data_set):
    path = data_set(per_file=4)
    file = path / "meta/episodes/chunk-000/file-000.parquet"
    rows = pyarrow.parquet.read_table(file).to_pylist()
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows + rows[:1]), file)
    assert taken(path)[0] == TRUE
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist([*rows, rows[0] | {"length": 8}]), file)
    assert "is listed more than once" in taken(path)[0][0] and taken(path)[0][1:] == TRUE[1:]


@pytest.mark.parametrize("video", [True, False])
def test_where_images_are_stored_shows_in_the_tables(data_set, video):
    path = data_set(video=video)
    feature = {"dtype": "image" if video else "video", "shape": [48, 64, 3]}
    edit_info(path, features={FRONT: feature}, video_path=None)
    found, notes = taken(path)
    assert found == TRUE and f"but it is stored in {'videos' if video else 'tables'}" in notes


def disturb(rows, rng):
    """Change the values of one column of the table of episodes, which also tell about videos."""
    name = str(rng.choice([BEGIN, END, FILE, CHUNK, "length", "dataset_from_index", "dataset_to_index"]))
    values = [row[name] for row in rows]
    unit = 1 / FPS if name in (BEGIN, END) else 1
    kind = rng.integers(6)
    if kind == 0:
        values[rng.integers(len(rows))] += unit * int(rng.choice([-3, -1, 1, 2, 5]))
    elif kind == 1:
        values = [value + unit * int(rng.choice([-1, 1, 2])) for value in values]
    elif kind == 2:
        values = [values[k] for k in rng.permutation(len(rows))]
    elif kind == 3:
        values = [None] * len(rows)
    elif kind == 4:
        values = [values[0]] * len(rows)
    else:
        values = [2 * value for value in values]
    for row, value in zip(rows, values, strict=True):
        row[name] = value


@pytest.mark.parametrize("seed", range(12))
def test_disturbed_metadata_never_gives_frames_of_another_episode(data_set, seed):
    rng = np.random.default_rng(seed)
    path = data_set(per_file=int(rng.choice([1, 2, 4])))
    files = sorted((path / "meta/episodes").rglob("*.parquet"))
    rows = [row for file in files for row in pyarrow.parquet.read_table(file).to_pylist()]
    disturb(rows, rng)
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), files[0])
    files[1].unlink()
    assert all(isinstance(video, str) or video == TRUE[k] for k, video in enumerate(taken(path)[0]))
