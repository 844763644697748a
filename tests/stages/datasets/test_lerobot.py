"""LeRobotDataset v3 as it comes: videos or pictures in tables, several cameras and files, and damaged in many ways."""

from __future__ import annotations

import shutil
import sys

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from artifacts import read_artifact
from tests.stages.datasets.foreign import FPS, FRONT, edit_episodes, edit_info, lerobot, number

LENGTHS = (9, 5, 7)
MIDDLES = [[0, 4, 8], [0, 2, 4], [0, 3, 6]]  # three frames at equal times
EXPECTED = [[number(episode, frame) for frame in frames] for episode, frames in enumerate(MIDDLES)]
TWO = (FRONT, "observation.images.wrist")


@pytest.fixture
def data_set(tmp_path):
    return lerobot(tmp_path / "set", LENGTHS)


@pytest.mark.parametrize(
    "made",
    [
        {},
        {"codec": "libsvtav1"},
        {"drift": 0.03},
        {"drift": -0.03},
        {"per_file": 1},
        {"per_file": 5},
        {"video": False},
        {"video": False, "row_groups": False},
        {"video": False, "per_file": 1},
    ],
)
def test_each_episode_is_a_demonstration(ifo, numbers, tmp_path, made):
    path = lerobot(tmp_path / "set", LENGTHS, **made)
    code, result, said = ifo(path)
    assert code == 0 and "imported 3 videos" in said, said
    assert numbers(result["path"]) == EXPECTED
    demos = read_artifact(result["path"])
    np.testing.assert_allclose(demos["times"], np.array(MIDDLES) / FPS, atol=1e-6)
    records = demos.config["videos"]
    assert [record["name"] for record in records] == [f"{path}, episode {k}" for k in range(3)]
    assert len({record["sha256"] for record in records}) == 3
    assert {record["camera"] for record in records} == {FRONT}
    assert [record["duration"] for record in records] == pytest.approx(np.array(LENGTHS) / FPS, abs=1e-5)


def test_what_is_taken_is_chosen_as_for_videos(ifo, numbers, data_set, tmp_path):
    _, result, _ = ifo(data_set, "--start", 0.1, "--end", 0.3)
    assert numbers(result["path"]) == [[number(k, frame) for frame in (1, 2, 3)] for k in range(3)]
    _, result, said = ifo(data_set, "--fps", 5, "--start", 0.2)
    assert numbers(result["path"])[1] == [number(1, frame) for frame in (2, 4, 4)]
    assert "repeat their last frame" in said
    (tmp_path / "crops.csv").write_text(f"video,x,y,w,h\n{data_set},8,0,48,48\n")
    code, result, said = ifo(data_set, "--crop-file", tmp_path / "crops.csv", "--size", "32x32")
    assert code == 0 and numbers(result["path"]) == EXPECTED, said
    code, result, _ = ifo(data_set, "--preview")
    assert code == 0 and result["videos"] == 3
    code, _, said = ifo(data_set, "--end", 0.65)
    assert code == 0 and said.count("less than --end 0.65") == 1 and "skipped 1" in said


def test_a_data_set_among_videos(ifo, numbers, data_set, tmp_path):
    from tests.stages.videos import write_video

    take = write_video(tmp_path / "take.mp4", count=5)
    code, result, _ = ifo(take, data_set, data_set)
    assert code == 0 and numbers(result["path"]) == [[0, 2, 4], *EXPECTED]
    code, _, said = ifo(take, "--camera", "front")
    assert code == 2 and "only datasets have named cameras" in said


@pytest.mark.parametrize("camera", [FRONT, "front"])
def test_one_of_several_cameras(ifo, numbers, tmp_path, camera):
    path = lerobot(tmp_path / "set", LENGTHS, TWO)
    shutil.rmtree(path / "videos" / TWO[1])  # not needed
    code, result, said = ifo(path, "--camera", camera)
    assert code == 0 and numbers(result["path"]) == EXPECTED, said


@pytest.mark.parametrize("words", [(), ("--camera", "back"), ("--camera", "observation.images")])
def test_cameras_are_listed_where_none_is_named(ifo, tmp_path, words):
    code, printed, said = ifo(lerobot(tmp_path / "set", LENGTHS, TWO), *words)
    assert (code, printed) == (2, None) and said.count("\n") == 1
    assert ", ".join(TWO) in said and "--camera" in said and not (tmp_path / "out").exists()


def test_pictures_in_videos_or_in_tables_need_no_more_than_their_files(ifo, numbers, data_set):
    shutil.rmtree(data_set / "data")
    assert numbers(ifo(data_set)[1]["path"]) == EXPECTED


def without_tables(path, change):
    shutil.rmtree(path / "data")
    edit_episodes(path, change)


def cut_short(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])


def pointer(path):
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")


TABLE, VIDEO = "meta/episodes/chunk-000/file-000.parquet", f"videos/{FRONT}/chunk-000/file-000.mp4"
BAD = {
    "old": (lambda path: edit_info(path, codebase_version="v2.1"), "v2.1, expected v3: convert it with python -m"),
    "new": (lambda path: edit_info(path, codebase_version="v4.0"), "version v4.0: expected v3"),
    "no JSON": (lambda path: cut_short(path / "meta/info.json"), "expected JSON with codebase_version"),
    "no table": (lambda path: (path / "meta/info.json").write_text("[]"), "expected JSON with codebase_version"),
    "deep": (lambda path: (path / "meta/info.json").write_text("[" * 100000), "expected JSON with codebase_version"),
    "no features": (lambda path: edit_info(path, features=[]), "no table of features"),
    "no camera": (lambda path: edit_info(path, features={}), "contains no images"),
    "no episodes": (lambda path: shutil.rmtree(path / "meta/episodes"), "no tables in meta/episodes"),
    "cut table": (lambda path: cut_short(path / TABLE), "file-000.parquet: is not a complete Parquet file"),
    "table of LFS": (lambda path: pointer(path / TABLE), "run git lfs pull"),
    "out of the folder": (lambda path: edit_info(path, video_path="../{video_key}.mp4"), "has the path '../{video_key"),
    "to the root": (lambda path: edit_info(path, video_path="/etc/{video_key}"), "has the path '/etc"),
    "a format that runs": (
        lambda path: edit_info(path, video_path="{video_key.__class__}/{file_index:03d}.mp4"),
        "has the path '{video_key.__class__}",
    ),
    "a format that swells": (
        lambda path: edit_info(path, video_path="{file_index:0999999999d}.mp4"),
        "has the path '{file_index:0999999999d}",
    ),
    "unknown field": (lambda path: edit_info(path, video_path="{episode_index:06d}.mp4"), "has the path '{episode_in"),
    "numbers missing": (
        lambda path: edit_episodes(path, lambda row: row.update(episode_index=None)),
        "without a number",
    ),
}
SOME_BAD = {
    "video missing": (lambda path: (path / VIDEO).unlink(), "file-000.mp4: no such file: download the whole dataset"),
    "video of LFS": (lambda path: pointer(path / VIDEO), "file-000.mp4: is a Git LFS pointer"),
    "video empty": (lambda path: (path / VIDEO).write_bytes(b""), "file-000.mp4: is empty"),
    "video cut": (lambda path: cut_short(path / VIDEO), "file-000.mp4: is not a video, or is truncated"),
    "no place": (
        lambda path: edit_episodes(path, lambda row: row["episode_index"] < 2 and row.update({INDEX: None})),
        f"does not record where its {FRONT} is stored",
    ),
    "contradiction": (
        lambda path: without_tables(
            path, lambda row: row["episode_index"] < 2 and row.update({"length": 50, END: row[END] + 0.2})
        ),
        "its tables are damaged; download the dataset again",
    ),
    "late": (
        lambda path: without_tables(
            path,
            lambda row: (
                row.update(
                    {PLACE: 70 + 10.0 * row["episode_index"], END: 79 + 10.0 * row["episode_index"], "length": 90}
                )
                if row["episode_index"] < 2
                else None
            ),
        ),
        "ends at 1.40 s, before",
    ),
}
INDEX = f"videos/{FRONT}/file_index"
PLACE, END = f"videos/{FRONT}/from_timestamp", f"videos/{FRONT}/to_timestamp"


@pytest.mark.parametrize("fault", BAD)
def test_a_bad_data_set_is_one_line(ifo, data_set, tmp_path, fault):
    harm, words = BAD[fault]
    harm(data_set)
    code, printed, said = ifo(data_set)
    skipped, last = said.splitlines()
    assert (code, printed) == (3, None) and skipped.startswith(f"skipped {data_set}") and words in skipped
    assert last == "ifo: none of the 1 videos can be used: nothing was written"
    code, _, said = ifo(data_set, "--strict")
    assert code == 3 and said.count("\n") == 1 and "--strict" in said and not (tmp_path / "out").exists()


@pytest.mark.parametrize("fault", SOME_BAD)
def test_bad_episodes_are_left_out_and_counted(ifo, numbers, data_set, tmp_path, fault):
    harm, words = SOME_BAD[fault]
    harm(data_set)
    code, result, said = ifo(data_set)
    assert code == 0 and words in said and "imported 1 videos, skipped 2" in said, said
    assert numbers(result["path"]) == EXPECTED[2:] and len(result["skipped"]) == 2
    assert said.count("skipped /") in (1, 2)
    assert ifo(data_set, "--strict")[0] == 3


def test_what_is_left_of_a_truncated_video_can_be_used(ifo, numbers, tmp_path):
    path = lerobot(tmp_path / "set", (9, 9, 9), per_file=3)
    video = path / VIDEO
    shorter = lerobot(tmp_path / "shorter", (9, 5), per_file=3) / VIDEO
    shutil.copy(shorter, video)
    code, result, said = ifo(path)
    assert code == 0 and "episode 1: is truncated to 5 of 9 frames" in said and "before" in said
    assert numbers(result["path"]) == [[number(0, frame) for frame in (0, 4, 8)]]
    code, result, said = ifo(path, "--end", 0.4)
    assert code == 0 and len(numbers(result["path"])) == 2 and "complete in the selected segment" in said


def test_damaged_pictures_and_missing_rows(ifo, numbers, tmp_path):
    path = lerobot(tmp_path / "set", LENGTHS, video=False, per_file=3)
    file = path / "data/chunk-000/file-000.parquet"
    rows = pyarrow.parquet.read_table(file).to_pylist()
    rows[4][FRONT]["bytes"] = rows[4][FRONT]["bytes"][:100]
    rows[9 + 2][FRONT]["bytes"] = None
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows[:-3]), file)
    code, _, said = ifo(path)
    assert code == 3, said
    assert (
        "a frame is not a complete PNG or JPEG" in said
        and "an image file of" in said
        and "is truncated to 4 of 7 frames" in said
    )
    cut_short(file)
    code, _, said = ifo(path)
    assert (
        code == 3
        and said.count("is not a complete Parquet file") == 1
        and "skipped 2 more for the same reason" not in said
    )


def test_a_data_set_that_was_not_downloaded_whole_says_so(ifo, data_set):
    edit_info(data_set, total_episodes=50)
    code, _, said = ifo(data_set)
    assert code == 0 and "meta/episodes lacks some of the 50 episodes" in said


def test_a_table_is_no_data_set_but_its_folder_is(ifo, data_set):
    code, _, said = ifo(data_set / "data/chunk-000/file-000.parquet")
    assert code == 3 and "pass the dataset folder, which contains meta/info.json" in said and said.count("\n") == 2


def test_without_pyarrow_a_line_says_what_to_install(ifo, data_set, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    code, printed, said = ifo(data_set)
    assert (code, printed) == (4, None) and said.count("\n") == 1 and "pip install 'ifo[lerobot]'" in said
