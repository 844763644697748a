"""robomimic's HDF5 format: data/demo_0/obs/CAMERA_image (T, H, W, 3) and the other arrays of a demonstration."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from artifacts import ArtifactError
from stages.datasets import hdf5
from stages.datasets.episode import Episode, choose_camera, episodes_in
from stages.datasets.frames import StoredFrames
from stages.footage.sources import natural_order

if TYPE_CHECKING:
    import h5py

MOST_TEXT = 2**20  # characters of env_args
TIMES = "times"  # our addition, next to obs: seconds (T,)


def is_robomimic(file: h5py.File) -> bool:
    """Whether the file has robomimic's groups."""
    data = hdf5.member(file, "data")
    return data is not None and hasattr(data, "keys") and next(_demos(data), None) is not None


def read_robomimic(path: Path, wanted: str) -> list[Episode]:
    """Return the demonstrations in natural order of their names.

    Args:
        path: The file.
        wanted: The value of --camera.

    Raises:
        ArtifactError: The file is damaged or contains no images.
        UsageError: The camera is ambiguous or unknown.
    """
    with hdf5.opened(path) as file:
        data = hdf5.member(file, "data")
        names = sorted(_demos(data), key=lambda name: natural_order(Path(name)))
        cameras = next(filter(None, (hdf5.cameras_in(hdf5.member(data, f"{name}/obs")) for name in names)), [])
        camera = choose_camera(path, cameras, wanted)
        rate = _rate(data.attrs)
    return episodes_in(path, path, camera, names, lambda name: _open(path, name, camera, rate))


def _open(path: Path, name: str, camera: str, rate: float) -> StoredFrames:
    label = f"{path}, {name}"
    with hdf5.opened(path, label) as file:
        demo = hdf5.member(file, f"data/{name}")
        if demo is None:
            raise ArtifactError(f"{label}: no longer exists: run the command again")
        steps = hdf5.whole_number(demo.attrs.get("num_samples")), hdf5.length_of(hdf5.member(demo, "actions"))
    return hdf5.footage(path, f"data/{name}/obs/{camera}", label, steps, f"data/{name}/{TIMES}", rate)


def _demos(data: h5py.Group) -> Iterator[str]:
    import h5py

    for name in hdf5.names_in(data):
        if isinstance(hdf5.member(data, f"{name}/obs"), h5py.Group):
            yield name


def _rate(attributes: Any) -> float:
    """Frames per second according to the environment's arguments; 0 if they do not record it."""
    try:
        text = attributes["env_args"]
        arguments = json.loads(text)["env_kwargs"] if len(text) <= MOST_TEXT else {}
        return hdf5.number(arguments.get("control_freq"))
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError):
        return 0.0
