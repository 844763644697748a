"""From nothing to an evaluated policy, by five commands and four pipes."""

import shutil
from html import unescape

import av
import numpy as np
import pytest

from artifacts import read_artifact, read_mp4, write_artifact
from stages.runtime.outputs import Output

pytestmark = pytest.mark.gl
KINDS = ("expert", "demos", "translator", "translation", "policy", "evaluation")
# What the same command writes again, whatever the clock says.
TIMING = ("curve/seconds",)


def assert_same_data(one, other):
    names = set(read_artifact(one).names())
    assert names == set(read_artifact(other).names())
    for name in names - set(TIMING):
        np.testing.assert_array_equal(read_artifact(one)[name], read_artifact(other)[name], err_msg=name)


def test_the_pipeline_ends_within_90_seconds_and_prints_one_json_object(toy):
    assert toy.seconds < 90
    assert toy.stdout.count("\n") == 1
    assert toy.summary["kind"] == "evaluation"
    assert toy.summary["runs"] == 1
    assert 0.0 < toy.summary["normalised_distance"] < 3.0


def test_every_artifact_verifies_and_knows_where_it_came_from(toy, ifo):
    done = ifo(toy.folder, "verify", *(toy.artifact(kind) for kind in KINDS))
    assert done.returncode == 0, done.stderr
    kind, chain = "evaluation", []
    artifact = read_artifact(toy.artifact(kind))
    while artifact.manifest.parents:
        artifact = artifact.parent(artifact.manifest.parents[0].kind, check=True)
        chain.append(artifact.kind)
    assert chain == ["policy", "translation", "translator", "demos", "expert"]
    assert {read_artifact(toy.artifact(kind)).manifest.seed for kind in KINDS} == {5}


def test_the_figures_of_an_evaluation_are_of_the_distances_in_it(toy):
    evaluation = read_artifact(toy.artifact("evaluation"))
    calm, noisy = evaluation["normalised_distance"], evaluation["normalised_distance_stochastic"]
    assert calm.mean() != noisy.mean()
    assert toy.summary["normalised_distance"] == pytest.approx(calm.mean())
    assert toy.summary["normalised_distance_stochastic"] == pytest.approx(noisy.mean())
    assert toy.summary["success_paper"] == float(noisy.mean() < evaluation.config["success_threshold"])
    assert toy.summary["success_deterministic"] == (calm < evaluation.config["success_threshold"]).mean()


def test_a_policy_without_its_translator_is_evaluated_and_said_to_be_of_unknown_method(toy, ifo, tmp_path):
    [run] = read_artifact(toy.artifact("evaluation")).config["runs"]
    assert run["method"] == "translation" and run["translator"]["steps"] > 0 and run["own_context"] is False
    alone = tmp_path / "alone.policy.h5"
    shutil.copy(toy.artifact("policy"), alone)
    done = ifo(tmp_path, "evaluate", alone)
    assert done.returncode == 0, done.stderr
    assert f"{alone}: recorded as translation (translator unknown): {alone} was made from" in done.stderr
    [run] = read_artifact(tmp_path / "alone.evaluation.h5").config["runs"]
    assert run["method"] == "translation (translator unknown)"
    assert run["translator"] is None and run["own_context"] is None


def test_videos_are_h264_and_show_every_frame(toy):
    for kind in ("demos", "translation", "policy", "evaluation"):
        path = toy.artifact(kind).with_suffix(".mp4")
        with av.open(str(path)) as container:
            assert container.streams.video[0].codec_context.name == "h264"
        frames = read_mp4(path)
        assert len(frames) == 25
        if kind in ("policy", "evaluation"):  # a header, and pictures of 240 pixels with a caption
            assert frames.shape[1:3] == (24 + 2 + 264, {"policy": 3 * 240 + 2 * 2, "evaluation": 240}[kind])


@pytest.mark.parametrize(
    ("stage", "reads", "writes"),
    [
        ("train-translator", "demos", "translator"),
        ("translate", "translator", "translation"),
        ("learn-policy", "translation", "policy"),
        ("evaluate", "policy", "evaluation"),
    ],
)
def test_each_stage_can_be_rerun_alone_with_the_same_result(toy, ifo, tmp_path, monkeypatch, stage, reads, writes):
    out, parent = tmp_path / f"again.{writes}.h5", toy.artifact(reads)
    write, content = Output.write, read_artifact(parent).content

    def write_while_the_parent_is_replaced(*arguments, **options):
        kept = parent.rename(tmp_path / "kept.h5")
        _write_changed(kept, parent)
        assert read_artifact(parent).content != content
        try:
            return write(*arguments, **options)
        finally:
            kept.replace(parent)

    monkeypatch.setattr(Output, "write", write_while_the_parent_is_replaced)
    done = ifo(toy.folder, stage, parent, "--out", out)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{out}\n"
    assert_same_data(out, toy.artifact(writes))
    # What it was made from is what it read, not what lay there in the end.
    assert read_artifact(out).parent(reads, check=True).content == content


def _write_changed(path, target):
    """The artifact at `path` with another seed, at `target`."""
    artifact = read_artifact(path)
    arrays = {name: artifact[name] for name in artifact.names()}
    write_artifact(target, artifact.kind, arrays, config=dict(artifact.config), seed=99, command="ifo else")


def test_demos_do_not_depend_on_the_number_of_workers(toy, ifo, tmp_path):
    out = tmp_path / "one.demos.h5"
    expert = toy.artifact("expert")
    words = ("collect-demos", "reach", "--preset", "toy", "--seed", 5, "--expert", expert, "--out", out)
    done = ifo(toy.folder, *words, "--workers", 1)
    assert done.returncode == 0, done.stderr
    assert_same_data(out, toy.artifact("demos"))


def test_a_report_tells_of_the_whole_pipeline(toy, ifo, tmp_path):
    page = tmp_path / "page.html"
    done = ifo(toy.folder, "report", "runs", "--out", page)
    assert (done.returncode, done.stdout) == (0, f"{page}\n"), done.stderr
    text = unescape(page.read_text())
    assert text.count("<video") == 2 and text.count("<img") == 2
    for kind in KINDS:
        assert read_artifact(toy.artifact(kind)).manifest.command in text
    assert "success, paper's criterion</dt><dd>" in text and "(below 0.5)" in text


@pytest.mark.parametrize(
    "option",
    [
        ("--reward", "oracle"),
        ("--reward", "video"),
        ("--reward", "pretrained", "--layer", "block2"),
        ("--reward", "gail", "--discriminator-steps", "2"),
        ("--reward", "tpil", "--discriminator-steps", "2"),
        ("--reward", "joints"),
        ("--learner", "ppo"),
        ("--learner", "gps"),
        ("--learner", "gps", "--fine-blur", "2"),
        pytest.param(
            ("--learner", "gps", "--reward", "pretrained", "--layer", "block2"),
            marks=pytest.mark.slow,
            id="gps pretrained",
        ),
    ],
    ids=lambda option: " ".join(option[1:]) if isinstance(option, tuple) else None,
)
def test_other_rewards_and_learners(toy, ifo, tmp_path, option):
    out = tmp_path / "other.policy.h5"
    done = ifo(toy.folder, "learn-policy", toy.artifact("translation"), *option, "--out", out)
    assert done.returncode == 0, done.stderr
    curve = read_artifact(out, "policy")["curve/normalised_distance"]
    assert len(curve) == 3
    assert np.isfinite(curve).all()


@pytest.mark.parametrize(
    ("stage", "reads", "words", "told"),
    [
        ("train-translator", "demos", ("--learning-rate", 10), "--learning-rate 10: after"),
        ("learn-policy", "translation", ("--kl", 1e30), "learning diverged in iteration 1"),
        ("learn-policy", "translation", ("--learner", "gps", "--log-std", 1000), "learning diverged in iteration 1"),
    ],
)
def test_what_diverges_is_told_and_not_kept(toy, ifo, tmp_path, stage, reads, words, told):
    out = tmp_path / f"x.{stage}.h5"
    done = ifo(toy.folder, stage, toy.artifact(reads), *words, "--quiet", "--out", out)
    assert (done.returncode, done.stdout) == (2, "") and not out.exists()
    assert done.stderr.startswith(f"ifo: {told}") and done.stderr.count("\n") == 1


def test_a_policy_given_twice_is_refused(toy, ifo, tmp_path):
    policy = toy.artifact("policy")
    done = ifo(toy.folder, "evaluate", policy, policy, "--out", tmp_path / "x.evaluation.h5")
    assert done.returncode == 2 and "given twice" in done.stderr and not any(tmp_path.iterdir())


def test_demonstrations_in_the_learners_own_context(toy, ifo, tmp_path):
    out = tmp_path / "own.demos.h5"
    words = ("collect-demos", "reach", "--preset", "toy", "--expert", toy.artifact("expert"), "--context-seed", 0)
    done = ifo(toy.folder, *words, "-n", 6, "--out", out)
    assert done.returncode == 0, done.stderr
    demos, translation = read_artifact(out, "demos"), read_artifact(toy.artifact("translation"))
    for name in demos.names("contexts"):
        np.testing.assert_array_equal(demos[name], np.repeat(translation[name], 6, axis=0))
    first = demos["frames"][:, 0].astype(int)
    assert np.abs(first - translation["context_frame"]).mean() < 6  # but for where the arm starts
    assert len(np.unique(first.reshape(6, -1), axis=0)) > 1


def test_an_evaluation_keeps_the_learning_curves_of_all_its_policies(toy, ifo, tmp_path):
    short, out = tmp_path / "short.policy.h5", tmp_path / "both.evaluation.h5"
    words = ("learn-policy", toy.artifact("translation"), "--reward", "oracle", "--iterations", 2, "--out", short)
    assert ifo(toy.folder, *words).returncode == 0
    assert ifo(toy.folder, "evaluate", toy.artifact("policy"), short, "--out", out).returncode == 0
    kept = read_artifact(out, "evaluation")
    for name in ("curve/samples", "curve/normalised_distance"):
        for row, path in zip(kept[name], (toy.artifact("policy"), short), strict=True):
            curve = read_artifact(path, "policy")[name]
            np.testing.assert_array_equal(row[: len(curve)], curve)
            assert np.isnan(row[len(curve) :]).all()


def test_an_empty_pipe_says_so(toy, ifo_process):
    for stage in ("train-translator", "translate", "learn-policy", "evaluate"):
        done = ifo_process(toy.folder, stage, input="")
        assert done.returncode == 3
        assert done.stdout == ""
        assert len(done.stderr.strip().splitlines()) == 1
        assert "standard input" in done.stderr
