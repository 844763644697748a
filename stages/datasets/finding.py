"""Detects the format of a dataset from its content."""

from __future__ import annotations

from pathlib import Path

from artifacts import ArtifactError
from artifacts.hdf5 import SIGNATURE
from stages.datasets.episode import Episode, check_is_there

HDF5_SUFFIXES = (".h5", ".hdf5", ".hdf")


def find_episodes(path: Path, camera: str) -> list[Episode]:
    """Return the episodes of the dataset at `path`; empty if `path` is not a dataset.

    Args:
        path: A LeRobot or Minari folder, or a robomimic or Minari HDF5 file.
        camera: The value of --camera; empty for the only camera.

    Raises:
        ArtifactError: The dataset is damaged, incomplete, of an unsupported version, or contains no images.
        UsageError: The camera is ambiguous or unknown.
        PlatformError: A library that is needed to read it is not installed.
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
        raise ArtifactError(f"{path}: is a table of a dataset: pass the dataset folder, which contains meta/info.json")
    if start != SIGNATURE:
        if path.suffix.lower() not in HDF5_SUFFIXES:
            return []
        check_is_there(path)
        raise ArtifactError(f"{path}: is not an HDF5 file: expected a robomimic or Minari file")
    with hdf5.opened(path) as data:
        robomimic, minari = is_robomimic(data), is_minari(data)
        artifact = str(data.attrs.get("kind", "")) if "ifo_version" in data.attrs else ""
    if robomimic:
        return read_robomimic(path, camera)
    if minari:
        return read_minari(path, path, camera)
    if artifact:
        raise ArtifactError(f"{path}: is already an ifo artifact: pass it to train-translator or export-demos")
    raise ArtifactError(
        f"{path}: is HDF5 with an unknown layout: expected robomimic's data/demo_0/obs or Minari's episode_0"
    )
