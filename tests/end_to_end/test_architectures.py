"""The network for real images goes through the pipeline like any other, with losses switched off or videos aligned."""

import numpy as np
import pytest
import torch

from artifacts import read_artifact, verify_artifact
from stages.rewards import negatives
from stages.translation.networks import RealTranslator, load_translator, to_images

pytestmark = pytest.mark.gl
TRAIN = ("--arch", "real", "--augment", "--steps", 2, "--evaluate-every", 2)


@pytest.fixture(scope="module")
def translator(toy, ifo):
    done = ifo(toy.folder, "train-translator", toy.artifact("demos"), *TRAIN, "--out", "other/real.translator.h5")
    assert done.returncode == 0, done.stderr
    return toy.folder / "other" / "real.translator.h5"


@pytest.fixture(scope="module")
def translation(toy, ifo, translator):
    done = ifo(toy.folder, "translate", translator)
    assert done.returncode == 0, done.stderr
    return toy.folder / done.stdout.strip()


def test_is_read_back_as_what_it_was(translator, translation):
    artifact = read_artifact(translator)
    verify_artifact(translator)
    assert (artifact.config["arch"], artifact.config["augment"], artifact.config["lambda_align"]) == ("real", True, 0.2)
    model = load_translator(artifact)
    assert isinstance(model, RealTranslator) and not model.training
    target = read_artifact(translation)
    context = model.encode_context(to_images(torch.from_numpy(target["context_frame"][None])))
    demos = artifact.parent("demos").read("frames", int(target["demonstrations"][0]))
    features = model.translate(model.encode(to_images(torch.from_numpy(demos))), context)
    assert features.shape == (25, 100)
    np.testing.assert_allclose(features.numpy(), target["features"][0], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("words", [("--negatives", 1, "--iterations", 2), ("--learner", "gps")])
def test_its_translations_reward(toy, ifo, translation, tmp_path, words, monkeypatch):
    monkeypatch.setattr(negatives, "STEPS", 2)
    done = ifo(toy.folder, "learn-policy", translation, *words, "--out", tmp_path / "x.policy.h5")
    assert done.returncode == 0, done.stderr
    assert np.isfinite(read_artifact(tmp_path / "x.policy.h5")["curve/return"]).all()


@pytest.mark.parametrize("words", [("--without", "rec"), ("--align", "dtw", "--ema", 0)])
def test_trains_without_losses_and_aligned(toy, ifo, tmp_path, words):
    out = tmp_path / "x.translator.h5"
    done = ifo(toy.folder, "train-translator", toy.artifact("demos"), *TRAIN, *words, "--out", out)
    assert done.returncode == 0, done.stderr
    assert np.isfinite(read_artifact(out)["metrics/psnr"])
