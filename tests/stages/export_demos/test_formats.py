"""What is exported holds what the libraries that read it demand, and comes back as it went."""

from __future__ import annotations

import json
from pathlib import Path

import av
import h5py
import numpy as np
import pandas
import pyarrow.parquet
import pytest

from artifacts import read_artifact
from stages.datasets import lerobot_video_writer, lerobot_writing
from tests.stages.export_demos.samples import FORMATS, FPS, KEY, LEAST_PSNR, NUMBERS, N, T, frames_of


def back(ifo, path, tmp_path):
    """The exported data set, imported again."""
    out = tmp_path / "back.demos.h5"
    code, _, said = ifo("import-demos", path, "--frames", T, "--size", "64x48", "--out", out)
    assert code == 0, said
    return read_artifact(out)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("times", [True, False])
def test_there_and_back(ifo, demos, tmp_path, name, times):
    path = demos(times=times)
    code, result, said = ifo("export-demos", path, "--format", name)
    assert code == 0 and "without actions" in said, said
    rate = FPS if times else 10
    assert result.pop("bytes") > 10_000
    assert result == {"path": str(tmp_path / FORMATS[name]), "kind": name, "demos": N, "frames": N * T, "fps": rate}
    returned = back(ifo, result["path"], tmp_path)
    np.testing.assert_array_equal(returned["frames"], read_artifact(path)["frames"])
    np.testing.assert_allclose(returned["times"], np.tile(np.arange(T) / rate, (N, 1)), atol=1e-6)


def test_a_video_comes_back_nearly(ifo, demos, tmp_path):
    path = demos()
    code, result, said = ifo("export-demos", path, "--format", "lerobot", "--video")
    assert code == 0 and "compression is lossy" in said
    returned = back(ifo, result["path"], tmp_path)["frames"].astype(float)
    errors = ((returned - read_artifact(path)["frames"]) ** 2).mean(axis=(2, 3, 4))
    assert (10 * np.log10(255**2 / errors)).min() > LEAST_PSNR
    worse = ifo("export-demos", path, "--format", "lerobot", "--video", "--crf", 40, "--out", tmp_path / "worse")[1]
    assert worse["bytes"] < result["bytes"]


@pytest.mark.parametrize("video", [True, False])
def test_lerobot_holds_what_the_library_looks_for(ifo, demos, tmp_path, video):
    words = ["--video"] if video else []
    _, result, _ = ifo("export-demos", demos(), "--format", "lerobot", "--task", "reach the disc", *words)
    root = Path(result["path"])
    info = json.loads((root / "meta/info.json").read_text())
    camera = info["features"].pop(KEY)
    assert info == {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": N,
        "total_frames": N * T,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": FPS,
        "splits": {"train": f"0:{N}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4" if video else None,
        "features": {
            name: {"dtype": "float32" if dtype == "float" else dtype, "shape": [1], "names": None}
            for name, dtype in NUMBERS.items()
        },
    }
    assert camera["shape"] == [48, 64, 3] and camera["names"] == ["height", "width", "channels"]
    assert camera["dtype"] == ("video" if video else "image")
    if video:
        assert camera["info"] == {
            "video.height": 48,
            "video.width": 64,
            "video.codec": "h264",
            "video.pix_fmt": "yuv420p",
            "video.fps": FPS,
            "video.channels": 3,
            "has_audio": False,
            "is_depth_map": False,
        }
    table = pyarrow.parquet.read_table(root / "data/chunk-000/file-000.parquet")
    types = {name: str(kind) for name, kind in zip(table.column_names, table.schema.types, strict=True)}
    assert types == ({} if video else {KEY: "struct<bytes: binary, path: string>"}) | NUMBERS
    features = json.loads(table.schema.metadata[b"huggingface"])["info"]["features"]
    assert list(features) == table.column_names and (video or features[KEY] == {"_type": "Image"})
    assert pyarrow.parquet.ParquetFile(root / "data/chunk-000/file-000.parquet").num_row_groups == N
    columns = {name: np.array(table[name].to_pylist()) for name in NUMBERS}
    np.testing.assert_array_equal(columns["index"], np.arange(N * T))
    np.testing.assert_array_equal(columns["episode_index"], np.repeat(np.arange(N), T))
    np.testing.assert_array_equal(columns["frame_index"], np.tile(np.arange(T), N))
    np.testing.assert_allclose(columns["timestamp"], np.tile(np.arange(T) / FPS, N), atol=1e-4)  # its tolerance
    tasks = pandas.read_parquet(root / "meta/tasks.parquet")
    assert tasks.index.name == "task" and tasks.loc["reach the disc"].task_index == 0
    check_episodes(root, video)
    check_statistics(root)


def check_episodes(root, video):
    rows = pyarrow.parquet.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for k, row in enumerate(rows):
        told = {name: value for name, value in row.items() if not name.startswith("stats/")}
        expected = {
            "episode_index": k,
            "tasks": ["reach the disc"],
            "length": T,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": k * T,
            "dataset_to_index": (k + 1) * T,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        if video:
            expected |= {
                f"videos/{KEY}/chunk_index": 0,
                f"videos/{KEY}/file_index": 0,
                f"videos/{KEY}/from_timestamp": pytest.approx(k * T / FPS),
                f"videos/{KEY}/to_timestamp": pytest.approx((k + 1) * T / FPS),
            }
        assert told == expected
        assert row["stats/episode_index/mean"] == [k] and row[f"stats/{KEY}/count"] == [T]
    if video:
        with av.open(str(root / f"videos/{KEY}/chunk-000/file-000.mp4")) as container:
            stream = container.streams.video[0]
            assert (stream.codec.canonical_name, stream.pix_fmt, stream.frames) == ("h264", "yuv420p", N * T)
            stamps = [float(frame.pts * stream.time_base) for frame in container.decode(stream)]
        np.testing.assert_allclose(stamps, np.arange(N * T) / FPS, atol=1e-4)


def check_statistics(root):
    stats = json.loads((root / "meta/stats.json").read_text())
    assert set(stats) == {KEY, *NUMBERS}
    kinds = {"min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"}
    frames = frames_of().reshape(-1, 3) / 255
    for name, figures in stats.items():
        assert set(figures) == kinds and figures["count"] == [N * T]
        shapes = {np.shape(figures[kind]) for kind in kinds - {"count"}}
        assert shapes == {(3, 1, 1) if name == KEY else (1,)}
    for kind, figure in {"min": np.min, "max": np.max, "mean": np.mean, "std": np.std, "q50": np.median}.items():
        np.testing.assert_allclose(np.ravel(stats[KEY][kind]), figure(frames, axis=0), atol=1e-9)
    np.testing.assert_allclose(np.ravel(stats[KEY]["q90"]), np.quantile(frames, 0.9, axis=0), atol=1.1 / 255)
    assert stats["index"]["max"] == [N * T - 1] and stats["episode_index"]["mean"] == [(N - 1) / 2]


@pytest.mark.parametrize("video", [True, False])
def test_lerobot_in_several_files_and_chunks(ifo, demos, tmp_path, monkeypatch, video):
    for module in (lerobot_video_writer, lerobot_writing):
        monkeypatch.setattr(module, "CHUNK", 2)
    monkeypatch.setattr(lerobot_video_writer, "VIDEO_BYTES", 1)
    monkeypatch.setattr(lerobot_writing, "DATA_BYTES", 1)
    path = demos()
    words = ["--video"] if video else []
    _, result, _ = ifo("export-demos", path, "--format", "lerobot", *words)
    files = sorted(str(file.relative_to(result["path"])) for file in Path(result["path"]).rglob("*.*"))
    folder, ending = (f"videos/{KEY}", "mp4") if video else ("data", "parquet")
    found = [name for name in files if name.startswith(folder) and name.endswith(ending)]
    assert found == [f"{folder}/chunk-{k // 2:03d}/file-{k % 2:03d}.{ending}" for k in range(N)]
    returned = back(ifo, result["path"], tmp_path)["frames"]
    np.testing.assert_allclose(returned, read_artifact(path)["frames"], atol=255 if video else 0)
    assert np.abs(returned.astype(int) - read_artifact(path)["frames"]).mean() < 5


def test_robomimic_holds_what_the_library_looks_for(ifo, demos):
    path = demos()
    _, result, _ = ifo("export-demos", path, "--format", "robomimic", "--camera", "agentview", "--task", "Reach")
    frames = read_artifact(path)["frames"]
    with h5py.File(result["path"]) as file:
        data = file["data"]
        assert list(file) == ["data"] and sorted(data) == [f"demo_{k}" for k in range(N)]
        assert data.attrs["total"] == N * T
        environment = json.loads(data.attrs["env_args"])
        assert environment["env_name"] == "Reach" and environment["env_kwargs"] == {"control_freq": FPS}
        assert {"type", "env_type"} < set(environment)
        for k in range(N):
            demo = data[f"demo_{k}"]
            assert demo.attrs["num_samples"] == T and list(demo["obs"]) == ["agentview_image"]
            np.testing.assert_array_equal(demo["obs/agentview_image"], frames[k])
            assert demo["actions"].shape == (T, 1) and np.isnan(demo["actions"]).all()
            assert demo["rewards"].shape == (T,) and np.isnan(demo["rewards"]).all()
            assert demo["dones"][...].tolist() == [False] * (T - 1) + [True]


def test_minari_itself_reads_it(ifo, demos, tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    path = demos()
    code, result, _ = ifo("export-demos", path, "--format", "minari", "--out", tmp_path / "sets" / "reach-v3")
    assert code == 0 and Path(result["path"]).name == "reach-v3"
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "sets"))
    assert list(minari.list_local_datasets()) == ["reach-v3"]
    loaded = minari.load_dataset("reach-v3")
    assert (loaded.total_episodes, loaded.total_steps) == (N, N * (T - 1))
    assert loaded.observation_space.shape == (48, 64, 3) and loaded.action_space.shape == (0,)
    for k, episode in enumerate(loaded):
        np.testing.assert_array_equal(episode.observations, read_artifact(path)["frames"][k])
        assert episode.actions.shape == (T - 1, 0) and np.isnan(episode.rewards).all()
        assert all(loaded.observation_space.contains(frame) for frame in episode.observations)
        assert all(loaded.action_space.contains(action) for action in episode.actions)
        assert episode.truncations.tolist() == [False] * (T - 2) + [True] and not episode.terminations.any()
        np.testing.assert_allclose(episode.infos["time"], np.arange(T) / FPS)


@pytest.mark.parametrize("name", FORMATS)
def test_contexts_stay_behind(ifo, demos, name):
    _, result, _ = ifo("export-demos", demos(), "--format", name)
    out = Path(result["path"])
    for file in [out, *out.rglob("*")]:
        if file.is_file():
            assert b"azimuth" not in file.read_bytes() and b"final_distance" not in file.read_bytes()
