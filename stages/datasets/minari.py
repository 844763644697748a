"""Minari's HDF5 format: data/main_data.hdf5 with episode_0/observations, which has one more entry than steps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from artifacts import ArtifactError
from stages.datasets import hdf5
from stages.datasets.episode import Episode, check_is_there, choose_camera, episodes_in
from stages.datasets.frames import StoredFrames
from stages.footage.sources import natural_order

if TYPE_CHECKING:
    import h5py

MAIN = "main_data.hdf5"
METADATA = "metadata.json"
OBSERVATIONS = "observations"
TIMES = "infos/time"  # seconds, one more entry than steps


def main_file(path: Path) -> Path | None:
    """The data file of a Minari folder, normally `data/main_data.hdf5`; None if this is not a Minari folder.

    Raises:
        ArtifactError: The data is stored as Arrow.
    """
    for folder in (path / "data", path):
        if (folder / MAIN).is_file():
            return folder / MAIN
        if (folder / METADATA).is_file() and (folder / "0").is_dir():
            raise ArtifactError(f"{path}: is a Minari dataset stored as Arrow: expected HDF5 with {MAIN}")
    return None


def is_minari(file: h5py.File) -> bool:
    """Whether the file has Minari's groups."""
    return any(hdf5.member(file, f"{name}/{OBSERVATIONS}") is not None for name in hdf5.names_in(file))


def read_minari(path: Path, file: Path, wanted: str) -> list[Episode]:
    """Return the episodes in natural order of their names.

    Args:
        path: The path that the user gave.
        file: The data file.
        wanted: The value of --camera.

    Raises:
        ArtifactError: The file is damaged or contains no images.
        UsageError: The camera is ambiguous or unknown.
    """
    check_is_there(file)
    with hdf5.opened(file) as data:
        names = [name for name in hdf5.names_in(data) if hdf5.member(data, f"{name}/{OBSERVATIONS}") is not None]
        names.sort(key=lambda name: natural_order(Path(name)))
        cameras = next(filter(None, (_cameras(hdf5.member(data, name)) for name in names)), [])
        camera = choose_camera(path, cameras, wanted)
    return episodes_in(file, path, camera, names, lambda name: _open(path, file, name, camera))


def _cameras(episode: h5py.Group) -> list[str]:
    """Names of the cameras. Observations are either the images themselves or contain them under any name."""
    observations = hdf5.member(episode, OBSERVATIONS)
    if hasattr(observations, "keys"):
        return [f"{OBSERVATIONS}/{name}" for name in hdf5.cameras_in(observations)]
    return [OBSERVATIONS] if hdf5.holds_pictures(observations) else []


def _open(path: Path, file: Path, name: str, camera: str) -> StoredFrames:
    label = f"{path}, {name}"
    with hdf5.opened(file, label) as data:
        episode = hdf5.member(data, name)
        if episode is None:
            raise ArtifactError(f"{label}: no longer exists: run the command again")
        steps = hdf5.whole_number(episode.attrs.get("total_steps")), hdf5.length_of(hdf5.member(episode, "actions"))
    expected = [number + 1 for number in steps if number]
    return hdf5.footage(file, f"{name}/{camera}", label, expected, f"{name}/{TIMES}", 0)
