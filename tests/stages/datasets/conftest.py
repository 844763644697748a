"""Imports as a user types them."""

from __future__ import annotations

import json

import pytest

from artifacts import read_artifact
from ifo_cli.main import main
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
