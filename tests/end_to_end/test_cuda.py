"""The pipeline on a GPU, by its commands."""

from __future__ import annotations

import json

import numpy as np
import pytest

from artifacts import read_artifact

pytestmark = [pytest.mark.cuda, pytest.mark.gl]
ON_GPU = ("--preset", "toy", "--device", "cuda")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, ifo):
    """Where a translator was trained on the GPU, and translated there."""
    made = tmp_path_factory.mktemp("cuda")
    for words in (
        ("collect-demos", "reach", "--preset", "toy", "--seed", "5", "--out", "x.demos.h5"),
        ("train-translator", "x.demos.h5", *ON_GPU, "--out", "x.translator.h5"),
        ("translate", "x.translator.h5", *ON_GPU, "--out", "x.translation.h5"),
    ):
        done = ifo(made, *words)
        assert done.returncode == 0, done.stderr
    return made


def test_translations_are_those_of_the_cpu(folder, ifo):
    done = ifo(folder, "translate", "x.translator.h5", "--device", "cpu", "--out", "cpu.translation.h5")
    assert done.returncode == 0, done.stderr
    here, there = read_artifact(folder / "cpu.translation.h5"), read_artifact(folder / "x.translation.h5")
    assert there.manifest.environment["device"] == "cuda"
    assert here.names() == there.names()
    # A GPU's convolutions round to ten bits of mantissa.
    np.testing.assert_allclose(there["target_images"], here["target_images"], atol=1.0)
    error = np.linalg.norm(there["target_features"] - here["target_features"])
    assert error < 0.01 * np.linalg.norm(here["target_features"])


@pytest.mark.parametrize(
    "words",
    ["", "--negatives 1", "--reward pretrained", "--reward gail", "--reward tpil", "--learner gps"],
)
def test_learns_and_evaluates(folder, ifo, tmp_path, words):
    if "pretrained" in words:
        pytest.importorskip("efficientnet_lite_pytorch")
    policy = tmp_path / "x.policy.h5"
    done = ifo(folder, "learn-policy", "x.translation.h5", *words.split(), *ON_GPU, "--out", policy)
    assert done.returncode == 0, done.stderr
    assert read_artifact(policy).manifest.environment["device"] == "cuda"
    done = ifo(folder, "evaluate", policy, "--json", "--out", tmp_path / "x.evaluation.h5")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["runs"] == 1


def test_trains_compiled_and_keeps_checkpoints(folder, ifo):
    words = ("train-translator", "x.demos.h5", *ON_GPU, "--steps", "6", "--checkpoint-every", "2", "--compile")
    done = ifo(folder, *words, "--out", "compiled.translator.h5")
    assert done.returncode == 0, done.stderr
    assert read_artifact(folder / "compiled.translator.h5", "translator").config["compile"]
