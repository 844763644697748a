"""train-translator --from: another translator's weights, fine-tuned."""

import numpy as np
import pytest

from artifacts import read_artifact, write_artifact
from artifacts.errors import PlatformError
from stages.reporting.methods import describe_method
from stages.runtime.outputs import Output
from stages.translation.networks import load_translator

pytestmark = pytest.mark.gl


def weights_of(path):
    return read_artifact(path).group("weights")


def test_without_steps_it_is_the_base_measured_on_these_demonstrations(toy, ifo, tmp_path):
    base, out = toy.artifact("translator"), tmp_path / "same.translator.h5"
    done = ifo(toy.folder, "train-translator", toy.artifact("demos"), "--from", base, "--steps", 0, "--out", out)
    assert done.returncode == 0, done.stderr
    made, started = read_artifact(out), read_artifact(base)
    for name in started.names("weights"):
        np.testing.assert_array_equal(made[name], started[name])
    # The base was measured on the same held-out demonstrations.
    assert made["metrics/psnr"] == started["metrics/psnr"]
    assert [parent.kind for parent in made.manifest.parents] == ["demos", "translator"]
    assert made.config["base"] == {name: started.config[name] for name in ("task", "steps", "demonstrations", "size")}
    done = ifo(toy.folder, "verify", out)
    assert done.returncode == 0 and "2 parents" in done.stdout, done.stderr


def test_fine_tuned_step_by_step_and_translated(toy, ifo):
    base = toy.artifact("translator")
    words = ("train-translator", toy.artifact("demos"), "--preset", "toy", "--from", base)
    done = ifo(toy.folder, *words, "--steps", 4, "--learning-rate", 1e-9, "--ema", 0, "--weight-decay", 0)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith(f"-from-{base.name.removesuffix('.translator.h5')}.translator.h5")
    path = toy.folder / done.stdout.strip()
    try:
        for name, value in weights_of(path).items():
            np.testing.assert_allclose(value, weights_of(base)[name], atol=1e-7)
        done = ifo(toy.folder, "translate", path, "-n", 2)
        assert done.returncode == 0, done.stderr
        # Another base is another translator, which would replace this one.
        other = toy.folder / "other.translator.h5"
        _with_seed(base, other, 77)
        done = ifo(toy.folder, *words[:-1], other, "--steps", 4, "--out", path)
        assert done.returncode == 2 and "differs from what this command makes" in done.stderr
    finally:
        for made in (toy.folder / "runs").glob("*-from-*"):
            made.unlink() if made.is_file() else None


def test_a_checkpoint_belongs_to_its_base(toy, ifo, tmp_path, monkeypatch):
    base, other, out = toy.artifact("translator"), tmp_path / "other.translator.h5", tmp_path / "x.translator.h5"
    _with_seed(base, other, 78)
    words = ("train-translator", toy.artifact("demos"), "--preset", "toy", "--steps", 3, "--checkpoint-every", 1)
    with monkeypatch.context() as patched:
        patched.setattr(Output, "write", _fails)
        assert ifo(toy.folder, *words, "--from", base, "--out", out).returncode == 4
    done = ifo(toy.folder, *words, "--from", other, "--out", out, "--resume")
    assert done.returncode == 2 and "was written with another input file" in done.stderr
    done = ifo(toy.folder, *words, "--from", base, "--out", out, "--resume")
    assert done.returncode == 0 and "resuming" in done.stderr, done.stderr
    whole = tmp_path / "whole.translator.h5"
    assert ifo(toy.folder, *words, "--from", base, "--out", whole).returncode == 0
    for name, value in weights_of(whole).items():
        np.testing.assert_array_equal(weights_of(out)[name], value)


def _fails(*arguments, **options):
    raise PlatformError("the disk is full")


def _with_seed(path, target, seed):
    artifact = read_artifact(path)
    arrays = {name: artifact[name] for name in artifact.names()}
    write_artifact(target, artifact.kind, arrays, config=dict(artifact.config), seed=seed, command="ifo else")


def test_another_frame_size(toy, ifo, tmp_path):
    demos = read_artifact(toy.artifact("demos"))
    arrays = {name: demos[name] for name in demos.names()}
    arrays["frames"] = arrays["frames"][:, :, 4:44, 8:]
    path, out = tmp_path / "cut.demos.h5", tmp_path / "cut.translator.h5"
    write_artifact(path, "demos", arrays, config=dict(demos.config), seed=5, command="ifo test")
    words = ("--preset", "toy", "--steps", 1, "--from", toy.artifact("translator"), "--out", out)
    done = ifo(tmp_path, "train-translator", path, *words)
    assert done.returncode == 0, done.stderr
    made = read_artifact(out)
    assert made.config["size"] == [40, 40] and made.config["base"]["size"] == [48, 48]
    assert load_translator(made).size == (40, 40)


def test_the_architecture_is_that_of_the_file(toy, ifo, tmp_path):
    base, words = tmp_path / "real.translator.h5", ("train-translator", toy.artifact("demos"), "--preset", "toy")
    done = ifo(toy.folder, *words, "--arch", "real", "--steps", 0, "--out", base)
    assert done.returncode == 0, done.stderr
    out = tmp_path / "x.translator.h5"
    done = ifo(toy.folder, *words, "--from", base, "--steps", 0, "--out", out)
    assert done.returncode == 0, done.stderr
    config = read_artifact(out).config
    assert (config["arch"], config["lambda_align"]) == ("real", 0.2)
    done = ifo(toy.folder, *words, "--arch", "compact", "--from", base, "--steps", 0, "--overwrite", "--out", out)
    assert done.returncode == 2
    assert done.stderr == f"ifo: --arch compact: {base} has architecture real; leave --arch out\n"


@pytest.mark.parametrize("named", ["demos", "missing"])
def test_what_is_no_translator_is_refused_before_the_input_is_read(toy, ifo, named):
    path = toy.artifact("demos") if named == "demos" else toy.folder / "base"
    done = ifo(toy.folder, "train-translator", "--from", path)  # Nothing is on standard input.
    assert done.returncode == 3 and done.stderr.startswith(f"ifo: {path}"), done.stderr
    assert done.stderr.count("\n") == 1


def test_the_base_is_not_replaced_by_its_own_fine_tuning(toy, ifo):
    base = toy.artifact("translator")
    done = ifo(toy.folder, "train-translator", toy.artifact("demos"), "--from", base, "--overwrite", "--out", base)
    assert done.returncode == 2 and "would replace the translator that --from names" in done.stderr


def test_an_evaluation_records_what_was_fine_tuned(toy, ifo, tmp_path):
    described, problem = describe_method(read_artifact(toy.artifact("policy")))
    assert not problem and "base" not in described["translator"]
    tuned, translation, policy = (tmp_path / f"tuned.{kind}.h5" for kind in ("translator", "translation", "policy"))
    words = ("train-translator", toy.artifact("demos"), "--from", toy.artifact("translator"), "--steps", 0)
    for command in (
        (*words, "--out", tuned),
        ("translate", tuned, "-n", 2, "--out", translation),
        ("learn-policy", translation, "--preset", "toy", "--iterations", 1, "--out", policy),
    ):
        done = ifo(toy.folder, *command)
        assert done.returncode == 0, done.stderr
    described, problem = describe_method(read_artifact(policy))
    assert not problem and described["translator"]["base"]["steps"] == 30


def test_a_translator_that_leads_nowhere_is_told(toy):
    assert read_artifact(toy.artifact("translator"))["metrics/feature_ratio"] > 1
    [line] = [line for line in toy.stderr.splitlines() if "a policy will probably not learn" in line]
    assert "more than 64 demonstrations" in line
