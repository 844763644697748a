"""Imports as a user types them, and a dataset of four episodes."""

from __future__ import annotations

import functools
import json
import shutil

import pytest

from artifacts import read_artifact
from ifo_cli.main import main
from tests.stages.datasets.foreign import lerobot
from tests.stages.datasets.four_episodes import LENGTHS
from tests.stages.videos import number_in

T = 3


@pytest.fixture
def ifo(tmp_path, capfd):
    """A function that runs import-demos: (exit code, what --json printed, standard error)."""

    def run(*words, out=tmp_path / "out" / "x.demos.h5", frames=T):
        capfd.readouterr()
        options = ["--out", str(out), "--frames", str(frames), "--json", "--overwrite"]
        code = main(["import-demos", *map(str, words), *options])
        printed, said = capfd.readouterr()
        return code, json.loads(printed) if printed else None, said

    return run


@pytest.fixture
def numbers():
    """A function: what the frames of an artifact show, (N, T)."""

    def read(path):
        return [[number_in(frame) for frame in video] for video in read_artifact(path, "demos")["frames"]]

    return read


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    """A function that makes a data set once for all tests: its folder."""
    return functools.cache(lambda **made: lerobot(tmp_path_factory.mktemp("made") / "set", LENGTHS, **made))


@pytest.fixture
def data_set(originals, tmp_path):
    """A function that makes a data set: its folder."""

    def make(**made):
        return shutil.copytree(originals(**made), tmp_path / "set")

    return make
