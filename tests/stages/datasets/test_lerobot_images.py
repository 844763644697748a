"""LeRobotDatasets whose images are files of their own."""

from __future__ import annotations

import cv2
import pyarrow
import pyarrow.parquet
import pytest

from stages.datasets.lerobot import read_lerobot
from tests.stages.datasets.foreign import FRONT, edit_episodes, edit_info, shown
from tests.stages.datasets.four_episodes import TABLE, TRUE, edit_rows, taken


def as_files(path, folder="images", name=lambda row: f"{row['index']:04d}.jpeg", text=False):
    """Store the images of the first table as files."""
    (path / folder).mkdir(parents=True, exist_ok=True)

    def move(rows):
        for row in rows:
            (path / folder / name(row)).write_bytes(row[FRONT]["bytes"])
            relative = f"{folder}/{name(row)}" if folder == "images" else name(row)
            row[FRONT] = relative if text else {"bytes": None, "path": relative}
        return rows

    edit_rows(path, move)


@pytest.mark.parametrize("text", [False, True])
def test_images_may_be_paths(data_set, text):
    path = data_set(video=False)
    as_files(path, text=text)
    assert taken(path) == (TRUE, "")
    episode = read_lerobot(path, "")[0]
    assert [file.name for file in episode.files[-10:]] == ["file-000.parquet", *(f"{k:04d}.jpeg" for k in range(9))]
    before = episode.sha256()
    (path / "images/0002.jpeg").write_bytes(cv2.imencode(".png", shown(3, 3))[1].tobytes())
    assert read_lerobot(path, "")[0].sha256() != before
    (path / "images/0003.jpeg").unlink()
    assert "an image file of" in taken(path)[0][0] and taken(path)[0][1:] == TRUE[1:]


@pytest.mark.parametrize("form", ["{root}/images/{name}", "./images//{name}"])
def test_paths_inside_the_data_set_may_be_written_in_any_way(data_set, form):
    path = data_set(video=False)
    as_files(path)
    for row in (rows := pyarrow.parquet.read_table(path / TABLE).to_pylist()):
        row[FRONT]["path"] = form.format(root=path, name=row[FRONT]["path"].removeprefix("images/"))
    edit_rows(path, lambda _: rows)
    assert taken(path) == (TRUE, "")


def test_images_may_lie_where_lerobot_records_them(data_set):
    path = data_set(video=False, per_file=1)
    as_files(path, f"images/{FRONT}/episode-000000", lambda row: f"frame-{row['frame_index']:06d}.png")
    assert taken(path) == (TRUE, "")


def test_a_change_of_any_file_that_matters_changes_the_digest(data_set):
    """A rerun must not keep what was made from other metadata, or from rows that another table contains."""
    path = data_set(video=False)
    edit_episodes(path, lambda row: row.update({"data/file_index": 9}))
    found = [read_lerobot(path, "")[0].sha256()]
    for change in (
        lambda: edit_info(path, fps=5),
        lambda: edit_episodes(path, lambda row: row.update(length=3)),
        lambda: edit_rows(path, lambda rows: rows[::-1]),
    ):
        change()
        found.append(read_lerobot(path, "")[0].sha256())
    assert len(set(found)) == 4


@pytest.mark.parametrize(
    "name", ["../secret.png", "/secret.png", "link.png", "x/../../secret.png", "a\0b", "a\nb", "x" * 5000]
)
def test_no_image_outside_the_data_set_is_read(data_set, tmp_path, name):
    path = data_set(video=False)
    secret = tmp_path / "secret.png"
    secret.write_bytes(cv2.imencode(".png", shown(0, 0))[1].tobytes())
    (path / "link.png").symlink_to(secret)
    name = str(secret) if name == "/secret.png" else name
    edit_rows(path, lambda rows: [row | {FRONT: {"bytes": None, "path": name}} for row in rows])
    found, _ = taken(path)
    assert (
        all("leads out of the dataset, and is not followed" in video for video in found[:2]) and found[2:] == TRUE[2:]
    )
