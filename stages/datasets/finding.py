"""Whose data set a path is, told by what it holds."""

from __future__ import annotations

from pathlib import Path

from artifacts import ArtifactError
from artifacts.hdf5 import SIGNATURE
from stages.datasets.episode import Episode, check_is_there

HDF5_SUFFIXES = (".h5", ".hdf5", ".hdf")


def find_episodes(path: Path, camera: str) -> list[Episode]:
    """The episodes of the data set that `path` is; empty where it is none.

    Args:
        path: A folder of LeRobot's or Minari's, or an HDF5 file of robomimic's or Minari's.
        camera: What --camera names; empty: the only camera.

    Raises:
        ArtifactError: The data set is damaged, incomplete, of a version that is not read, or holds no pictures.
        UsageError: The camera is not to be told.
        PlatformError: What reads it is not installed.
    """
    from stages.datasets.minari import main_file, read_minari

    try:
        if path.is_dir():
            if (path / "meta" / "info.json").exists():
                from stages.datasets.lerobot import read_lerobot

                return read_lerobot(path, camera)
            main = main_file(path)
            return [] if main is None else read_minari(path, main, camera)
        return _in_file(path, camera) if path.is_file() else []
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror or error}): check its permissions") from error


def _in_file(path: Path, camera: str) -> list[Episode]:
    from stages.datasets import hdf5
    from stages.datasets.minari import is_minari, read_minari
    from stages.datasets.robomimic import is_robomimic, read_robomimic

    with open(path, "rb") as file:
        start = file.read(len(SIGNATURE))
    if path.suffix.lower() == ".parquet":
        raise ArtifactError(f"{path}: is a table of a data set: name its folder, the one with meta/info.json in it")
    if start != SIGNATURE:
        if path.suffix.lower() not in HDF5_SUFFIXES:
            return []
        check_is_there(path)
        raise ArtifactError(f"{path}: is no HDF5 file: expected robomimic's or Minari's")
    with hdf5.opened(path) as data:
        robomimic, minari = is_robomimic(data), is_minari(data)
        artifact = str(data.attrs.get("kind", "")) if "ifo_version" in data.attrs else ""
    if robomimic:
        return read_robomimic(path, camera)
    if minari:
        return read_minari(path, path, camera)
    if artifact:
        raise ArtifactError(f"{path}: is an artifact of ifo already: give it to train-translator or export-demos")
    raise ArtifactError(
        f"{path}: is HDF5 of another layout: expected robomimic's data/demo_0/obs or Minari's episode_0"
    )
