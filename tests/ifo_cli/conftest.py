"""Stages that do nothing, so that the command line can be tested without learning anything."""

from __future__ import annotations

import io
import sys
from types import ModuleType

import numpy as np
import pytest

from artifacts import write_artifact
from ifo_cli.main import main
from stages.runtime.run import StageResult

STAGE_FUNCTIONS = {
    "train-expert": "train_expert",
    "collect-demos": "collect_demos",
    "train-translator": "train_translator",
    "translate": "translate",
    "learn-policy": "learn_policy",
    "evaluate": "evaluate",
}


class Terminal(io.TextIOWrapper):
    """Standard input as somebody's keyboard."""

    def isatty(self):
        return True


@pytest.fixture
def run_ifo(capfd, monkeypatch):
    """A function that runs `ifo` in this process: (exit code, standard output, standard error)."""

    def run(*words, stdin="", terminal=False):
        data = io.BytesIO(stdin if isinstance(stdin, bytes) else stdin.encode())
        monkeypatch.setattr(sys, "stdin", Terminal(data) if terminal else io.TextIOWrapper(data))
        capfd.readouterr()
        code = main([str(word) for word in words])
        captured = capfd.readouterr()
        return code, captured.out, captured.err

    return run


@pytest.fixture
def calls(monkeypatch, tmp_path):
    """Replace every stage; each call is recorded as (stage, arguments) and answered with a path."""
    recorded = []

    def replace(stage, name):
        def fake(*arguments):
            recorded.append((stage, arguments))
            print("a library that prints")
            summary = {
                "score": np.float32(0.5),
                "rates": np.arange(2),
                "bad": float("nan"),
                "frames": np.int64(3),
            }
            return StageResult(tmp_path / "result.h5", summary)

        module = ModuleType(f"stages.{name}")
        setattr(module, name, fake)
        monkeypatch.setitem(sys.modules, f"stages.{name}", module)

    for stage, name in STAGE_FUNCTIONS.items():
        replace(stage, name)
    return recorded


@pytest.fixture
def make(tmp_path):
    """A function that writes a small artifact of a kind, as `stages` would have under preset and seed."""
    arrays = {
        "demos": {
            "frames": np.zeros((2, 3, 8, 8, 3), np.uint8),
            "final_distance": np.zeros(2, np.float32),
        },
        "translation": {
            "context_frame": np.zeros((8, 8, 3), np.uint8),
            "target_features": np.zeros((3, 4), np.float32),
            "target_images": np.zeros((3, 8, 8, 3), np.uint8),
        },
        "evaluation": {
            "final_distance": np.zeros((1, 2), np.float32),
            "summary/normalised_distance": np.asarray(0.25),
            "summary/interval": np.array([0.1, 0.4]),
        },
    }

    def write(kind, name="x", preset="toy", seed=7, parents=(), config=None):
        content = arrays.get(kind, {"weights/a": np.arange(3, dtype=np.float32)})
        config = {"stage": kind, "n": 2, **({"preset": preset} if preset else {}), **(config or {})}
        path = tmp_path / f"{name}.{kind}.h5"
        return write_artifact(
            path,
            kind,
            content,
            config=config,
            seed=seed,
            command=f"ifo {kind}",
            parents=parents,
            environment={"python": "3"},
        )

    return write
