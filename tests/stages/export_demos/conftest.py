"""Demonstrations to export, and commands as a user types them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from artifacts import write_artifact
from ifo_cli.main import main
from tests.stages.export_demos.samples import FPS, frames_of


@pytest.fixture
def demos(tmp_path):
    """A function that writes a demos artifact."""

    def write(frames=None, times=True):
        frames = frames_of() if frames is None else frames
        arrays = {
            "frames": frames,
            "final_distance": np.zeros(len(frames)),
            "contexts/azimuth": np.arange(len(frames)),
            **({"times": np.tile(np.arange(frames.shape[1]) / FPS, (len(frames), 1))} if times else {}),
        }
        path = tmp_path / "x.demos.h5"
        return write_artifact(
            path, "demos", arrays, config={"task": "reach"}, seed=0, command="ifo collect-demos reach"
        )

    return write


@pytest.fixture
def ifo(capfd):
    """A function that runs a command with --json: (exit code, what it printed, standard error)."""

    def run(*words):
        capfd.readouterr()
        code = main([*map(str, words), "--json"])
        printed, said = capfd.readouterr()
        return code, json.loads(printed) if printed else None, said

    return run
