"""The evaluation artifact: what it records of each run, in one process and without any learning."""

import json

import numpy as np
import pytest

from artifacts import ArtifactError, UsageError, read_artifact, read_mp4, tile_videos, write_artifact
from stages import evaluate as module
from stages.config.stages import EvaluateConfig
from stages.evaluate import evaluate
from stages.learners.gps.controller import LinearGaussianController
from stages.learners.policy import Policy
from stages.reporting.figures import figures
from stages.reporting.films import film_task
from stages.reporting.intervals import bootstrap_mean
from stages.reporting.judging import simulated_episodes
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions
from stages.runtime.seeding import integer
from stages.simulation.registry import distribution, learner_context, make_task

pytestmark = pytest.mark.gl
CONFIG = EvaluateConfig(episodes=3)
FACTS = ("seed", "context_seed", "contexts", "vary", "translation_metrics", "samples", "learning_minutes")


@pytest.fixture(scope="module")
def task():
    return make_task("reach")


@pytest.fixture(scope="module")
def context(task):
    return learner_context(task, 4, distribution("paper"))


@pytest.fixture
def policy(tmp_path, task, context):
    """A function that writes a policy which always pushes with the same torque."""

    def write(name="a", torque=0.2, iterations=2, seed=5, **fields):
        steps, size = task.control_steps, 6
        weights = LinearGaussianController.constant(steps, size, 3, 0.3).arrays()
        weights["offsets"] = weights["offsets"] + torque
        curve = {
            "samples": np.arange(1, iterations + 1) * 100.0,
            "normalised_distance": np.linspace(1.0, 0.6, iterations),
            "seconds": np.full(iterations, 45.0),
        }
        config = {
            "stage": "learn-policy", "preset": "toy", "task": "reach", "learner": "gps", "reward": "oracle",
            "observation_size": size + 1, "action_size": 3, "context_seed": 4, "contexts": "paper", "vary": "goal",
            "translation_metrics": {"psnr": 20.0}, **fields,
        }  # fmt: skip
        arrays = {f"weights/{key}": value for key, value in weights.items()}
        arrays |= {f"curve/{key}": value for key, value in curve.items()}
        arrays |= {f"contexts/{key}": value for key, value in context.items()}
        return write_artifact(tmp_path / f"{name}.policy.h5", "policy", arrays, config=config, seed=seed, command="ifo")

    return write


def run(out=None, seed=5, quiet=True, **options):
    return RunOptions(seed=seed, out=out, command="ifo evaluate", progress=Progress(quiet=quiet), **options)


def test_an_evaluation_records_distances_curves_and_facts_of_every_run(policy, task, context, tmp_path, capsys):
    paths = [policy("a", 0.2), policy("b", -0.3, iterations=3, context_seed=7)]
    out = tmp_path / "x.evaluation.h5"
    result = evaluate(CONFIG, run(out, seed=9, quiet=False), paths)
    said = capsys.readouterr().err
    assert result.path == out
    found = read_artifact(out, "evaluation")
    for row, path in enumerate(paths):
        loaded = Policy.load(read_artifact(path, "policy"))
        expected = simulated_episodes(task, loaded, context, 3, 9, row)
        assert set(expected) == {name for name in found.names() if "/" not in name}
        for name, values in expected.items():
            np.testing.assert_allclose(found[name][row], values, err_msg=name)
    np.testing.assert_array_equal(found["curve/samples"], [[100, 200, np.nan], [100, 200, 300]])
    np.testing.assert_allclose(found["curve/normalised_distance"], [[1.0, 0.6, np.nan], [1.0, 0.8, 0.6]])
    expected = figures(found["normalised_distance"], found["normalised_distance_stochastic"], task.success_threshold)
    assert {name: result.summary[name] for name in expected} == expected
    assert result.summary["curves"] == str(tmp_path / "x.evaluation.png")
    assert result.summary["video"] == str(tmp_path / "x.evaluation.mp4")
    for name, value in expected.items():
        if not isinstance(value, str):
            np.testing.assert_array_equal(found[f"summary/{name}"], value)
    config, manifest = found.config, found.manifest
    assert (config["stage"], config["task"], config["success_threshold"], config["episodes"]) == (
        "evaluate",
        "reach",
        0.5,
        3,
    )
    assert (manifest.seed, manifest.command) == (9, "ifo evaluate") and manifest.environment["torch"]
    assert [parent.kind for parent in manifest.parents] == ["policy", "policy"]
    first, second = config["runs"]
    assert {name: first[name] for name in FACTS} == {
        "seed": 5, "context_seed": 4, "contexts": "paper", "vary": "goal", "translation_metrics": {"psnr": 20.0},
        "samples": 200, "learning_minutes": 1.5,
    }  # fmt: skip
    assert first["policy"] == "a.policy.h5" and first["last_batch_distance"] == pytest.approx(0.6)
    assert (second["policy"], second["samples"], second["context_seed"]) == ("b.policy.h5", 300, 7)
    assert second["last_batch_distance"] == pytest.approx(0.6) and second["learning_minutes"] == 2.25
    assert first["learner"] == "gps" and first["reward"] == "oracle"
    low, high = expected["success_paper_interval"]
    for part in (
        f"{expected['normalised_distance_stochastic']:.3f} (stochastic policy",
        f"deterministic {expected['normalised_distance']:.3f})",
        f"{expected['succeeded']} of 2 runs",
        f"{low:.2f} to {high:.2f}",
        f"{expected['success_deterministic']:.0%} of the deterministic episodes",
        "a.policy.h5: recorded as",
        "evaluate: 2/2 policies",
    ):
        assert part in said, said


def test_noise_follows_from_the_runs_seed_and_the_policys_number(task, context):
    seeds = []

    class Still:
        def act(self, observations, noise=None):
            seeds.append(None if noise is None else noise.initial_seed())
            return np.zeros((len(observations), 3))

    for seed, index in ((7, 0), (7, 1), (8, 0)):
        simulated_episodes(task, Still(), context, 2, seed, index)
    expected = [
        each
        for args in ((7, 0), (7, 1), (8, 0))
        for each in [None] * 50 + [integer(args[0], "evaluate-noise", args[1])] * 50
    ]
    assert seeds == expected


def test_of_two_runs_the_runs_are_resampled():
    near, far = np.array([[0.1, 0.3], [0.6, 0.9]]), np.array([[0.2, 0.2], [0.7, 0.8]])
    found = figures(near, far, 0.5)
    assert found["resampled"] == "runs"
    assert found["normalised_distance_interval"] == bootstrap_mean(np.array([0.2, 0.75]))
    assert found["normalised_distance_stochastic_interval"] == bootstrap_mean(np.array([0.2, 0.75]))
    assert found["success_deterministic_interval"] == bootstrap_mean(np.array([1.0, 0.0]))


def test_the_video_shows_the_first_policies_side_by_side(policy, task, context, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "SHOWN", 2)
    paths = [policy(name, torque) for name, torque in (("a-rather-long-name-of-a-run", 0.3), ("b", -0.3), ("c", 0.9))]
    result = evaluate(EvaluateConfig(episodes=1), run(tmp_path / "x.evaluation.h5"), paths)
    shown = [film_task(task, Policy.load(read_artifact(path)), context) for path in paths[:2]]
    expected = tile_videos([shown], labels=["-long-name-of-a-run"[-16:], "b"], scale=1)
    assert expected.shape[1:3] == (24 + 2 + 264, 2 * 240 + 2)
    shown = read_mp4(result.summary["video"])
    assert shown.shape == expected.shape
    assert np.abs(shown.astype(float) - expected).mean() < 4
    assert (tmp_path / "x.evaluation.png").read_bytes().startswith(b"\x89PNG")
    assert read_artifact(result.path)["final_distance"].shape == (3, 1), "all are evaluated"


@pytest.mark.parametrize(
    ("count", "seed", "name"),
    [
        (1, 5, "a.evaluation.h5"),
        (1, 6, "a-s6.evaluation.h5"),
        (2, 5, "a-and-1-more.evaluation.h5"),
        (3, 6, "a-and-2-more-s6.evaluation.h5"),
    ],
)
def test_the_default_name_says_how_many_and_another_seed(policy, tmp_path, count, seed, name):
    paths = [policy(each) for each in "abc"[:count]]
    assert evaluate(EvaluateConfig(episodes=1), run(seed=seed), paths).path == tmp_path / name


def test_a_finished_evaluation_is_kept_and_another_one_is_not_replaced(policy, tmp_path):
    path, out = policy(), tmp_path / "x.evaluation.h5"
    first = evaluate(EvaluateConfig(episodes=1), run(out), [path])
    before = out.stat()
    again = evaluate(EvaluateConfig(episodes=1), run(out), [path])
    assert out.stat() == before
    assert json.loads(json.dumps(again.summary)) == json.loads(json.dumps(first.summary))
    with pytest.raises(UsageError, match="--overwrite"):
        evaluate(EvaluateConfig(episodes=2), run(out), [path])
    evaluate(EvaluateConfig(episodes=2), run(out, overwrite=True), [path])
    assert read_artifact(out)["final_distance"].shape == (1, 2)


def test_policies_of_two_tasks_or_one_given_twice_are_refused(policy, tmp_path):
    path = policy()
    (tmp_path / "sub").mkdir()
    with pytest.raises(UsageError, match=r"a\.policy\.h5: given twice"):
        evaluate(CONFIG, run(), [path, tmp_path / "sub" / ".." / "a.policy.h5"])
    with pytest.raises(ArtifactError, match=r"reach, sweep\)") as caught:
        evaluate(CONFIG, run(), [policy("b", task="sweep"), path])
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.glob("*.evaluation.*"))
