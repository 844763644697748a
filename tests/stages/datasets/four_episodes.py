"""A LeRobotDataset of four episodes, and what is taken from it."""

from __future__ import annotations

import numpy as np
import pyarrow
import pyarrow.parquet

from artifacts import ArtifactError
from stages.datasets.lerobot import read_lerobot
from tests.stages.datasets.foreign import number
from tests.stages.videos import number_in

LENGTHS = (9, 5, 7, 6)
TABLE = "data/chunk-000/file-000.parquet"
TRUE = [[number(episode, frame) for frame in range(length)] for episode, length in enumerate(LENGTHS)]


def taken(path):
    """What each episode shows, or the message that refuses it; and all remarks."""
    found, notes = [], set()
    for episode in read_lerobot(path, ""):
        try:
            footage = episode.open()
            if footage.cut:
                raise ArtifactError(footage.cut)
            found.append([cropped(picture) for _, picture in footage.pictures(np.arange(len(footage.times)))])
            notes |= set(footage.notes)
        except ArtifactError as error:
            found.append(str(error))
    return found, " ".join(notes)


def cropped(picture):
    return number_in(picture[:, 8:56])


def edit_rows(path, change, file=TABLE):
    rows = pyarrow.parquet.read_table(path / file).to_pylist()
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(change(rows)), path / file)
