"""LeRobot datasets whose content is not what it says: one line, no crash, no time or memory to speak of."""

from __future__ import annotations

import functools
import json
import os
import shutil
import struct

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from artifacts import ArtifactError, PlatformError
from stages.config.demonstrations import ImportConfig
from stages.datasets import parquet
from stages.datasets.finding import find_episodes
from stages.footage.moments import Segment, choose_frames
from stages.import_demos import Importer, _remarks, _room_for
from stages.runtime.run import RunOptions
from tests.stages.datasets.foreign import FRONT, edit_episodes, edit_info, lerobot

INFO, EPISODES = "meta/info.json", "meta/episodes/chunk-000/file-000.parquet"
TABLE, VIDEO = "data/chunk-000/file-000.parquet", f"videos/{FRONT}/chunk-000/file-000.mp4"


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    """A function that makes a data set once for all tests: its folder."""
    return functools.cache(lambda video: lerobot(tmp_path_factory.mktemp("made") / "set", (4, 5), video=video))


@pytest.fixture
def data_set(originals, tmp_path):
    """A function that makes a data set: its folder."""
    return lambda video=True: shutil.copytree(originals(video), tmp_path / "set")


def refusals(path):
    """The messages that refuse the dataset, or its episodes."""
    try:
        episodes = find_episodes(path, "")
    except ArtifactError as error:
        return [str(error)]
    found = []
    for episode in episodes:
        try:
            footage = episode.open()
            list(footage.pictures(np.arange(len(footage.times))))
        except ArtifactError as error:
            found.append(str(error))
        episode.sha256()
    return found


def pipe(file):
    file.unlink()
    os.mkfifo(file)


def endless(file):
    file.unlink()
    file.symlink_to("/dev/zero")


def large(file):
    with open(file, "r+b") as opened:
        opened.truncate(100 * 2**20)


@pytest.mark.parametrize("harm", [pipe, endless, large])
@pytest.mark.parametrize("name", [INFO, EPISODES, TABLE, VIDEO])
def test_files_that_never_end(data_set, harm, name):
    path = data_set(name != TABLE)
    harm(path / name)
    said = refusals(path)
    assert (said or (name, harm) == (VIDEO, large)) and all("\n" not in line and len(line) < 600 for line in said)


VALUES = [None, [], {}, "x", 5, -1, 1.5, True, float("nan"), float("inf"), 10**400, "9" * 5000, "\0", {"dtype": []}]


KEYS = ["codebase_version", "features", FRONT, "dtype", "shape", "info", "fps", "video_path", "data_path"]


@pytest.mark.parametrize("key", KEYS)
def test_info_of_any_type(data_set, key):
    path = data_set(video=False)
    text = (path / INFO).read_text()
    for value in VALUES:
        info = json.loads(text)
        feature = info["features"][FRONT]
        {FRONT: info["features"], "dtype": feature, "shape": feature, "info": feature}.get(key, info)[key] = value
        (path / INFO).write_text(json.dumps(info))
        assert all(line.isprintable() and len(line) < 600 for line in refusals(path)), value


@pytest.mark.parametrize(
    "content", ["", "[" * 10**5, '{"a":' * 10**5, "NaN", "nul", "\0", '"' + "x" * 10**6, "[1" + ",1" * 10**5]
)
def test_info_that_is_no_info(data_set, content):
    path = data_set()
    (path / INFO).write_text(content)
    (said,) = refusals(path)
    assert "\n" not in said and len(said) < 600


TEMPLATES = [
    "{chunk_index.__class__}", "{chunk_index:>1000000000}", "{chunk_index:0999999999d}", "{0}", "{}", "{chunk_index!r}",
    "a\0b", "a\nb", "../{chunk_index}", "/etc/passwd", "x/../../y", "x" * 5000, "/".join("x" * 5000), "*", "**", "[",
    ".", "{video_key}" * 500, "{chunk_index", "%s", "~/x", "é" * 200, "/".join(["x" * 250] * 30),
]  # fmt: skip


@pytest.mark.parametrize("video", [True, False])
@pytest.mark.parametrize("template", TEMPLATES, ids=lambda text: text[:20].replace("\0", "NUL"))
def test_paths_of_any_form(data_set, template, video):
    path = data_set(video)
    edit_info(path, **{"video_path" if video else "data_path": template})
    said = refusals(path)
    assert said and all("\n" not in line and "\0" not in line and len(line) < 800 for line in said)


@pytest.mark.parametrize("name", ["a\0b", "../../x", "/etc", "x" * 5000, "é" * 200, "\x1b[2J", "", "a/b", "*"])
def test_cameras_of_any_name(data_set, name):
    path = data_set()
    edit_info(path, features={name: {"dtype": "video", "shape": [48, 64, 3]}})
    (said,) = refusals(path)
    assert said.isprintable() and len(said) < 600


@pytest.mark.parametrize("value", [None, -1, 2**62, float("nan"), 1e300, "x", [1]], ids=str)
@pytest.mark.parametrize("video", [True, False])
def test_episodes_of_any_number(data_set, video, value):
    path = data_set(video)
    rows = pyarrow.parquet.read_table(path / EPISODES).to_pylist()
    for name in rows[0]:
        shutil.copy(path / EPISODES, path / "kept")
        edit_episodes(path, lambda row, name=name: row.update({name: value}))
        assert all(line.isprintable() and len(line) < 600 for line in refusals(path))
        shutil.move(path / "kept", path / EPISODES)


def test_a_data_set_without_episodes(data_set):
    path = data_set()
    for file in (path / "meta/episodes").rglob("*.parquet"):
        pyarrow.parquet.write_table(pyarrow.parquet.read_table(file)[:0], file)
    assert refusals(path) == [f"{path}: has no episodes: expected at least one in meta/episodes"]


def test_episodes_of_one_frame(tmp_path):
    for video in (True, False):
        path = lerobot(tmp_path / f"set-{video}", (1, 5, 1), video=video)
        episodes = find_episodes(path, "")
        assert [len(episode.open().times) for episode in episodes] == [1, 5, 1]
        with pytest.raises(ArtifactError, match="episode 0: has only one frame: expected a video"):
            choose_frames(episodes[0].open(), Segment(3))


def test_tables_of_many_equal_rows(data_set, monkeypatch):
    monkeypatch.setattr(parquet, "FEW_ROWS", 1000)
    count = 10**5
    for video, name in ((True, EPISODES), (False, TABLE)):
        path = data_set(video)
        schema = pyarrow.parquet.read_schema(path / name)
        columns = {field.name: pyarrow.nulls(count, pyarrow.int64()) for field in schema}
        pyarrow.parquet.write_table(pyarrow.table(columns), path / name)
        assert any(f"declares {count} rows, more than it has bytes" in line for line in refusals(path))
        shutil.rmtree(path)


def png(width, height):
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", width, height) + bytes(50) + b"IEND"


def put_images(path, values):
    table = pyarrow.parquet.read_table(path / TABLE)
    place = table.column_names.index(FRONT)
    pyarrow.parquet.write_table(table.set_column(place, FRONT, values), path / TABLE)


@pytest.mark.parametrize("side", [30000, 65535])
def test_images_of_a_huge_size(data_set, side):
    path = data_set(video=False)
    put_images(path, pyarrow.array([{"bytes": png(side, side), "path": "x.png"}] * 9))
    assert all(f"has {side}x{side} pixels" in line for line in refusals(path)) and refusals(path)


@pytest.mark.parametrize(
    "values", [[1] * 9, [[1, 2]] * 9, [{"a": 1}] * 9, [{"bytes": 5}] * 9, [None] * 9, [{"bytes": {"bytes": b""}}] * 9]
)
def test_images_of_another_type(data_set, values):
    path = data_set(video=False)
    put_images(path, pyarrow.array(values))
    assert refusals(path) and all(line.isprintable() for line in refusals(path))


def test_images_that_expand_to_much_more_than_is_stored(tmp_path, monkeypatch):
    monkeypatch.setattr(parquet, "MEMORY", 10**6)
    file = tmp_path / "x.parquet"
    images = [b"\x89PNG" + bytes(2 * 10**6)] * 2
    pyarrow.parquet.write_table(pyarrow.table({"x": images}), file, compression="zstd", use_dictionary=False)
    with pytest.raises(ArtifactError, match=r"expands to .* bytes of x: do not trust this file"):
        list(parquet.rows(file, "x", np.array([0])))


def test_equal_images_are_not_all_in_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(parquet, "MEMORY", 10**6)
    file = tmp_path / "x.parquet"
    image = np.random.default_rng(0).bytes(400_000)
    pyarrow.parquet.write_table(
        pyarrow.table({"x": pyarrow.array([image] * 20).dictionary_encode().cast("binary")}), file
    )
    with parquet.opened(file) as opened:
        assert parquet._batch(opened, file, "x", 0) == 2
    assert [len(value) for value in parquet.rows(file, "x", np.array([0, 7, 19]))] == [400_000] * 3


def test_more_episodes_than_fit_in_memory():
    for count in (10**9, 10**18):
        with pytest.raises(PlatformError, match=f"{count} videos of 25 frames do not fit in memory"):
            _room_for((count, 25, 480, 640, 3))


def test_not_every_one_of_many_reasons_is_printed(capfd):
    run = RunOptions()
    importer = Importer(ImportConfig(), run)
    for k in range(5000):
        importer._skip(f"episode {k}", ArtifactError(f"episode {k}: is damaged"))
    assert capfd.readouterr().err.count("skipped episode") == 100 and len(importer.skipped) == 5000
    assert "skipped more videos for 4900 other reasons, which the artifact lists" in _remarks(importer, [])


def test_paths_are_not_looked_for_where_all_images_are_in_the_table(data_set):
    path = data_set(video=False)
    assert parquet.paths(path / TABLE, FRONT) == []
    assert [file.suffix for file in find_episodes(path, "")[0].files].count(".parquet") == 3
