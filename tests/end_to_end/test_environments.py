"""The five commands in a Gymnasium environment that ifo does not know."""

import dataclasses
import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import ifo as ifo_api
from artifacts import ArtifactError, UsageError, read_artifact, write_artifact, write_png

HERE = "tests.stages.environments.slides"
SLIDE, RIGHT = f"{HERE}:Slide", f"{HERE}:go_right"
FILM = ("--size", "16x16", "--frames", 6, "-n", 16, "--preset", "toy", "--workers", 1)
LEARN = ("--preset", "toy", "--iterations", 2, "--episodes", 4)


@pytest.fixture(scope="module")
def made(ifo, tmp_path_factory):
    """A folder with demonstrations, translator, translation and policy, and what the commands said."""
    folder = tmp_path_factory.mktemp("slides")
    said = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IFO_ENVS", SLIDE)
        for words in (
            ("collect-demos", f"env:{SLIDE}", "--demonstrator", RIGHT, *FILM, "--out", "s.demos.h5"),
            ("train-translator", "s.demos.h5", "--out", "s.translator.h5"),
            ("translate", "s.translator.h5", "--env-seed", 7, "--out", "s.translation.h5"),
            ("learn-policy", "s.translation.h5", *LEARN, "--out", "s.policy.h5"),
            ("evaluate", "s.policy.h5", "--episodes", 3, "--json", "--out", "s.evaluation.h5"),
        ):
            said[words[0]] = ifo(folder, *words)
            assert said[words[0]].returncode == 0, said[words[0]].stderr
    return folder, said


@pytest.fixture(autouse=True)
def trusted(monkeypatch):
    monkeypatch.setenv("IFO_ENVS", SLIDE)


def test_from_a_demonstrator_to_an_evaluated_policy(made):
    folder, said = made
    demos = read_artifact(folder / "s.demos.h5", "demos")
    assert demos["frames"].shape == (16, 6, 16, 16, 3) and demos["success"].all()
    assert len(set(demos["environment/seed"].tolist())) == 16
    assert "has no camera of MuJoCo" in said["collect-demos"].stderr
    translation = read_artifact(folder / "s.translation.h5", "translation")
    environment = translation.config["environment"]
    assert environment["name"] == SLIDE and environment["seed"] == 7, "the environment of the demonstrations"
    assert environment["control_steps"] == 10, "the limit of the environment"
    assert {"return_target", "return_still", "return_random", "target_motion"} <= set(translation.group("metrics"))
    assert "return of the target" in said["translate"].stderr
    policy = read_artifact(folder / "s.policy.h5", "policy")
    assert policy.config["environment"] == environment and policy.config["observation_size"] == 3
    assert len(policy["curve/success"]) == len(policy["curve/env_return"]) == 2
    assert policy["curve/samples"].tolist() == [40, 80]
    assert "success rate" in said["learn-policy"].stderr
    evaluation = read_artifact(folder / "s.evaluation.h5", "evaluation")
    assert evaluation["success"].shape == evaluation["env_return_stochastic"].shape == (1, 3)
    summary = json.loads(said["evaluate"].stdout)
    assert summary["success"] == evaluation["success"].mean() and 0 <= summary["success_stochastic"] <= 1
    assert "episodes succeed" in said["evaluate"].stderr
    for kind in ("translation", "policy", "evaluation"):
        assert (folder / f"s.{kind}.mp4").exists()


def test_a_report_shows_environments_beside_tasks(made, toy, ifo):
    done = ifo(made[0], "report", "s.evaluation.h5", toy.artifact("evaluation"), "--out", "r.html", "--json")
    assert done.returncode == 0, done.stderr
    shown = json.loads(done.stdout)
    evaluation = read_artifact(made[0] / "s.evaluation.h5", "evaluation")
    assert [item["success"] for item in shown["environments"]] == [evaluation["success_stochastic"].mean()]
    assert len(shown["methods"]) == 1
    assert "s.evaluation.h5" in (made[0] / "r.html").read_text()
    assert (made[0] / "r-environments.csv").read_text().count("\n") == 2


@pytest.mark.parametrize(
    ("example", "options"),
    [
        ("sb3_ppo.py", ("--envs", 2, "--rollout", 20, "--episodes", 2)),
        ("cleanrl_ppo.py", ("--envs", 2, "--rollout", 22, "--minibatches", 2)),
    ],
)
def test_other_libraries_learn_from_a_translation(made, example, options):
    root = Path(__file__).parents[2]
    words = [sys.executable, root / "examples" / example, "s.translation.h5", "--steps", 80, *options]
    done = subprocess.run(
        [*map(str, words)],
        cwd=made[0],
        env={**os.environ, "PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr, "the scene is the translation's"
    assert "success" in done.stdout and "env_return" in done.stdout


def test_the_environment_of_a_file_is_the_learners(made, monkeypatch):
    path = made[0] / "s.translation.h5"
    env = ifo_api.make_environment(path)
    observation, _ = env.reset(seed=3)
    assert observation.shape == (3,) and observation[-1] == 0
    frames = [env.render()]
    assert np.array_equal(frames[0], read_artifact(path, "translation")["context_frame"]), "in the context, at its size"
    tracked = ifo_api.TranslationReward(env, path)
    tracked.reset()
    paid = []
    for step in range(1, 11):
        observation, reward, terminated, truncated, info = tracked.step(np.array([1.0, 0.0], np.float32))
        paid.append(reward)
        assert observation[-1] == pytest.approx(step / 10) and (terminated, truncated) == (step == 10, False)
    assert [step for step, reward in enumerate(paid, 1) if reward] == [2, 4, 6, 8, 10], "where the target has frames"
    assert info["outcome"]["success"] == 1.0
    monkeypatch.setenv("IFO_ENVS", "")
    with pytest.raises(UsageError, match="IFO_ENVS"):
        ifo_api.make_environment(path)


def test_what_a_users_environment_raises_is_raised(made):
    from stages.environments.lockstep import Strict
    from stages.environments.making import EnvironmentFault, make_environment
    from stages.environments.spec import EnvironmentSpec

    spec = EnvironmentSpec(SLIDE, {"broken": "step"}, 0, 10, 6, (16, 16))
    env = Strict(make_environment(spec), spec, range(0))
    env.reset()
    with pytest.raises(EnvironmentFault, match="step failed") as caught:
        env.step(np.zeros(2, np.float32))
    assert isinstance(caught.value.__cause__, RuntimeError)
    env.reset()  # A fault ends only its own episode.
    spec = EnvironmentSpec(SLIDE, {"broken": "render"}, 0, 10, 6, (16, 16))
    env = Strict(make_environment(spec), spec, range(0))
    env.reset()
    with pytest.raises(EnvironmentFault, match="render failed"):
        env.render()
    for _ in range(10):
        env.step(np.zeros(2, np.float32))
    with pytest.raises(UsageError, match="the episode has ended: call reset first"):
        env.step(np.zeros(2, np.float32))


def test_only_files_of_environments_have_one(toy):
    with pytest.raises(ArtifactError, match="was not made for a Gymnasium environment"):
        ifo_api.make_environment(toy.artifact("translation"))


def test_the_context_is_what_the_environment_shows_first(made):
    from tests.stages.environments.slides import Slide

    env = Slide()
    env.reset(seed=7)
    expected = env.render().reshape(16, 2, 16, 2, 3).astype(float).mean(axis=(1, 3))
    shown = read_artifact(made[0] / "s.translation.h5", "translation")["context_frame"]
    assert np.abs(shown - expected).max() <= 1


def test_code_that_a_file_names_needs_permission(made, ifo, monkeypatch):
    monkeypatch.delenv("IFO_ENVS")
    for words in (("translate", "s.translator.h5"), ("learn-policy", "s.translation.h5"), ("evaluate", "s.policy.h5")):
        done = ifo(made[0], *words, "--out", "new.h5")
        assert done.returncode == 2 and done.stdout == ""
        assert f"export IFO_ENVS={SLIDE}" in done.stderr and done.stderr.count("\n") == 1
    done = ifo(made[0], "translate", "s.translator.h5", "--env", SLIDE, "-n", 2, "--out", "typed.translation.h5")
    assert done.returncode == 0, "typed on the command line"
    assert f"later stages use {SLIDE} only with your permission" in done.stderr


@pytest.mark.parametrize("learner", [("--reward", "oracle"), ("--reward", "gail"), ("--learner", "gps")])
def test_other_rewards_and_learners(made, ifo, learner, tmp_path):
    out = tmp_path / "x.policy.h5"
    done = ifo(made[0], "learn-policy", "s.translation.h5", *LEARN, *learner, "--workers", 1, "--out", out)
    assert done.returncode == 0, done.stderr
    assert read_artifact(out, "policy")["curve/samples"].tolist() == [40, 80]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--reward", "joints"), "--reward joints needs a simulated task"),
        (("--reward", "oracle", "--learner", "gps"), "--learner gps needs a reward with a target"),
    ],
)
def test_what_an_environment_does_not_have_is_refused(made, ifo, words, expected):
    done = ifo(made[0], "learn-policy", "s.translation.h5", *LEARN, *words, "--out", "new.policy.h5")
    assert done.returncode == 2 and expected in done.stderr and not (made[0] / "new.policy.h5").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--env-kwargs", "still=true"), "frames do not change during episodes"),
        (("--episode-steps", 3), "episodes of 3 steps are too short for videos of 6 frames: give --episode-steps 5"),
        (("--env-kwargs", "width=64"), "another aspect ratio than frames of 16x16: crop them with --crop"),
        (("--crop", "0,0,40,40"), "--crop 0,0,40,40 extends beyond its image of 32x32"),
        (("--env-kwargs", "limit"), "--env-kwargs limit: expected KEY=VALUE"),
        (("--viewpoint", "10,0,1"), "leave --viewpoint out"),
        (("--viewpoint", "10"), "--viewpoint 10: expected AZIMUTH,ELEVATION,DISTANCE"),
    ],
)
def test_what_is_wrong_with_a_scene_is_said_before_learning(made, ifo, words, expected, tmp_path):
    out = tmp_path / "x.translation.h5"
    done = ifo(made[0], "translate", "s.translator.h5", "--env", SLIDE, "-n", 2, *words, "--out", out)
    assert expected in done.stderr
    assert out.exists() == (done.returncode == 0)


def test_an_environment_without_a_limit_needs_one():
    from stages.config.stages import TranslateConfig
    from stages.environments.scene import first_scene

    config = TranslateConfig(env=SLIDE, env_kwargs=("limit=0",))
    with pytest.raises(UsageError, match="sets no limit to its episodes: give --episode-steps"):
        first_scene(config, 6, (16, 16))
    spec, _ = first_scene(dataclasses.replace(config, episode_steps=12), 6, (16, 16))
    assert spec.control_steps == 12


def test_a_scene_that_changed_since_is_noticed_before_learning(made, ifo, tmp_path):
    source = read_artifact(made[0] / "s.translation.h5", "translation")
    arrays = {name: source[name] for name in source.names()}
    arrays["context_frame"] = 255 - arrays["context_frame"]
    path = write_artifact(
        tmp_path / "other.translation.h5",
        "translation",
        arrays,
        config=dict(source.config),
        seed=0,
        command="ifo",
        parents=[source.parent("translator")],
    )
    done = ifo(tmp_path, "learn-policy", path, *LEARN, "--out", tmp_path / "x.policy.h5")
    assert "first frame differs from the context frame" in done.stderr


def test_a_demonstrator_is_needed_and_options_of_tasks_have_no_effect(ifo, tmp_path):
    done = ifo(tmp_path, "collect-demos", f"env:{SLIDE}", *FILM)
    assert done.returncode == 2 and "give --demonstrator MODULE:ATTR" in done.stderr
    done = ifo(tmp_path, "collect-demos", f"env:{SLIDE}", "--demonstrator", RIGHT, *FILM, "--vary", "goal")
    assert done.returncode == 2 and "--vary has no effect on env:" in done.stderr
    done = ifo(tmp_path, "collect-demos", "reach", "--preset", "toy", "--demonstrator", RIGHT)
    assert done.returncode == 2 and "--demonstrator has no effect on reach, only on env:ID" in done.stderr


def test_a_context_image_is_cropped_and_reduced(made, ifo, tmp_path):
    image = np.zeros((40, 50, 3), np.uint8)
    image[4:36, 10:42] = read_artifact(made[0] / "s.translation.h5")["context_frame"].repeat(2, 0).repeat(2, 1)
    write_png(tmp_path / "scene.png", image)
    words = ("translate", made[0] / "s.translator.h5", "--context-image", tmp_path / "scene.png", "-n", 2)
    out = tmp_path / "x.translation.h5"
    done = ifo(tmp_path, *words, "--out", out)
    assert done.returncode == 2 and "50x40 pixels, expected 16x16 or more in the same aspect ratio" in done.stderr
    done = ifo(tmp_path, *words, "--crop", "10,4,32,32", "--out", out)
    assert done.returncode == 0, done.stderr
    frame = read_artifact(made[0] / "s.translation.h5")["context_frame"]
    np.testing.assert_array_equal(read_artifact(out)["context_frame"], frame)


def test_an_interrupted_run_resumes_bit_for_bit(made, ifo, monkeypatch, tmp_path):
    from stages.learners import loop

    words = ("learn-policy", made[0] / "s.translation.h5", *LEARN, "--workers", 1, "--iterations", 3)
    whole, resumed = tmp_path / "whole.policy.h5", tmp_path / "resumed.policy.h5"
    assert ifo(tmp_path, *words, "--out", whole).returncode == 0
    plain, taken = loop._learn_once, []

    def interrupted(*given):
        taken.append(given)
        if len(taken) == 3:
            raise KeyboardInterrupt
        return plain(*given)

    with monkeypatch.context() as patch:
        patch.setattr(loop, "_learn_once", interrupted)
        assert ifo(tmp_path, *words, "--out", resumed).returncode == 130
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        done = ifo(tmp_path, *words, "--resume", "--out", resumed)
    assert done.returncode == 0 and "resuming" in done.stderr, done.stderr
    one, other = read_artifact(whole), read_artifact(resumed)
    for name in one.names():
        if name != "curve/seconds":
            np.testing.assert_array_equal(other[name], one[name], err_msg=name)


def test_a_policy_learns_to_do_what_the_videos_show(ifo, tmp_path):
    """It observes no reward of the environment: only the translated videos say that the square belongs on the right."""
    for words in (
        ("collect-demos", f"env:{SLIDE}", "--demonstrator", RIGHT, *FILM, "-n", 64, "--out", "s.demos.h5"),
        ("train-translator", "s.demos.h5", "--steps", 150, "--videos", 8, "--frames", 2, "--out", "s.translator.h5"),
        ("translate", "s.translator.h5", "--env-seed", 7, "--out", "s.translation.h5"),
        (
            *("learn-policy", "s.translation.h5", "--iterations", 12, "--episodes", 20, "--workers", 1, "--blur", 2),
            *("--out", "s.policy.h5"),
        ),
    ):
        done = ifo(tmp_path, *words)
        assert done.returncode == 0, done.stderr
    success = read_artifact(tmp_path / "s.policy.h5", "policy")["curve/success"]
    assert success[0] < 0.5 and success[-1] > 0.9


def test_policies_of_different_environments_are_not_pooled(made, ifo, tmp_path):
    other = tmp_path / "other.translation.h5"
    words = ("translate", "s.translator.h5", "--env", SLIDE, "--env-kwargs", "limit=12", "-n", 2, "--out", other)
    assert ifo(made[0], *words).returncode == 0
    policy = tmp_path / "other.policy.h5"
    done = ifo(made[0], "learn-policy", other, *LEARN, "--workers", 1, "--out", policy)
    assert done.returncode == 0, done.stderr
    done = ifo(made[0], "evaluate", "s.policy.h5", policy, "--episodes", 2, "--out", tmp_path / "x.evaluation.h5")
    assert done.returncode == 3 and "evaluate each task separately" in done.stderr


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"frames": 5}, "translations of 6 frames of 16x16 pixels do not fit"),
        ({"size": [32, 32]}, "which has 6 of 32x32: translate again"),
        ({"name": "no.such:make"}, "environment no.such:make: cannot be made (ModuleNotFoundError"),
    ],
)
def test_a_record_that_contradicts_the_target_is_refused(made, ifo, tmp_path, changed, expected, monkeypatch):
    from artifacts import write_artifact

    monkeypatch.setenv("IFO_ENVS", f"{SLIDE},no.such:make")
    source = read_artifact(made[0] / "s.translation.h5", "translation")
    config = dict(source.config)
    config["environment"] = {**config["environment"], **changed}
    path = write_artifact(
        tmp_path / "x.translation.h5",
        "translation",
        {name: source[name] for name in source.names()},
        config=config,
        seed=0,
        command="ifo",
        parents=[source.parent("translator")],
    )
    done = ifo(tmp_path, "learn-policy", path, *LEARN, "--out", tmp_path / "x.policy.h5")
    assert done.returncode in (2, 3) and expected in done.stderr and done.stderr.count("\n") == 1


def test_a_demonstrator_whose_module_does_not_exist_is_told_in_one_line(ifo, tmp_path):
    done = ifo(tmp_path, "collect-demos", f"env:{SLIDE}", "--demonstrator", "no.such:one", *FILM)
    assert done.returncode == 2 and "ifo: demonstrator no.such:one: cannot be loaded" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_demonstrators_own_video_judges_and_is_a_target(made, ifo):
    words = ("translate", "s.translator.h5", "--env-seed", 7)
    done = ifo(made[0], *words, "--demonstrator", RIGHT, "--out", "v.translation.h5")
    assert done.returncode == 0 and "mean translation against the expert's video" in done.stderr, done.stderr
    translation = read_artifact(made[0] / "v.translation.h5", "translation")
    assert np.array_equal(translation["expert_frames"][0], translation["context_frame"]), "in the learner's context"
    assert translation["expert_frames"].shape == (6, 16, 16, 3)
    assert {"psnr", "feature_ratio"} <= set(translation.group("metrics"))
    done = ifo(made[0], "learn-policy", "v.translation.h5", *LEARN, "--reward", "video", "--out", "v.policy.h5")
    assert done.returncode == 0, done.stderr
    done = ifo(made[0], *words, "--demonstrator", f"{HERE}:go_left", "--out", "w.translation.h5")
    assert "go_left fails in this context" in done.stderr
    done = ifo(made[0], "learn-policy", "s.translation.h5", *LEARN, "--reward", "video", "--out", "w.policy.h5")
    assert done.returncode == 3 and "translate` again with --demonstrator NAME and another --out" in done.stderr


def test_an_untranslated_demonstration_is_a_target_as_it_is(made, ifo):
    out = "u.translation.h5"
    done = ifo(made[0], "translate", "s.translator.h5", "--env-seed", 7, "-n", 1, "--untranslated", "--out", out)
    assert done.returncode == 0, done.stderr
    translation = read_artifact(made[0] / out, "translation")
    [chosen] = translation["demonstrations"]
    demonstration = read_artifact(made[0] / "s.demos.h5")["frames"][chosen]
    np.testing.assert_allclose(translation["target_images"], demonstration, atol=0.01)
    done = ifo(made[0], "learn-policy", out, *LEARN, "--out", "u.policy.h5")
    assert done.returncode == 0, done.stderr
    done = ifo(made[0], "evaluate", "u.policy.h5", "--episodes", 2, "--out", "u.evaluation.h5")
    assert read_artifact(made[0] / "u.evaluation.h5").config["runs"][0]["method"] == "untranslated"


def test_the_demonstrations_environment_by_name_is_filmed_as_they_were(made, ifo, monkeypatch):
    monkeypatch.delenv("IFO_ENVS")  # What is typed needs no permission.
    done = ifo(made[0], "translate", "s.translator.h5", "--env", SLIDE, "--env-seed", 7, "--out", "n.translation.h5")
    assert done.returncode == 0, done.stderr
    named, left_out = (read_artifact(made[0] / name) for name in ("n.translation.h5", "s.translation.h5"))
    assert named.config["environment"] == left_out.config["environment"]


def filmed(folder, spec):
    """Demonstrations that were filmed in an environment, without their content."""
    frames = np.zeros((1, spec.frames, *spec.size, 3), np.uint8)
    config = {"environment": spec.described()}
    path = write_artifact(folder / "x.demos.h5", "demos", {"frames": frames}, config=config, seed=0, command="ifo test")
    return read_artifact(path)


def test_code_that_is_not_used_needs_no_permission(tmp_path, monkeypatch):
    from stages.config.stages import TranslateConfig
    from stages.environments.scene import as_filmed
    from stages.environments.spec import EnvironmentSpec

    monkeypatch.delenv("IFO_ENVS")
    spec = EnvironmentSpec("Reacher-v5", {"xml_file": "/a/b.xml"}, 0, 40, 6, (16, 16), success="other:judge")
    demos = filmed(tmp_path, spec)
    typed = TranslateConfig(env="Reacher-v5", env_kwargs=("xml_file=/my.xml",), success="mine:judge")
    assert as_filmed(typed, demos, ()) == dataclasses.replace(typed, episode_steps=40)
    for options, named in (({"success": "mine:judge"}, "xml_file"), ({"env_kwargs": ("a=1",)}, "other:judge")):
        with pytest.raises(UsageError, match=named):
            as_filmed(TranslateConfig(**options), demos, ())


def test_another_viewpoint_and_arguments_win_over_those_of_the_demonstrations(tmp_path):
    from stages.config.stages import TranslateConfig
    from stages.environments.scene import as_filmed
    from stages.environments.spec import EnvironmentSpec
    from stages.environments.viewpoints import Viewpoint

    spec = EnvironmentSpec("Reacher-v5", {"reward_control_weight": 2}, 0, 40, 6, (16, 16), None, Viewpoint(5, -30, 0.5))
    demos = filmed(tmp_path, spec)
    same = as_filmed(TranslateConfig(), demos, ())
    assert (same.viewpoint, same.episode_steps) == ("5,-30,0.5", 40)
    assert same.env_kwargs == ("reward_control_weight=2",)
    named = as_filmed(TranslateConfig(env="Reacher-v5"), demos, {"env"})
    assert named == dataclasses.replace(same, env_kwargs=()), "arguments are the user's"
    given = {"viewpoint": "0,0,1", "episode_steps": 60, "env_kwargs": ("reward_control_weight=3",)}
    own = as_filmed(TranslateConfig(**given), demos, set(given))
    assert {name: getattr(own, name) for name in given} == given
    other = TranslateConfig(env="Pusher-v5")
    assert as_filmed(other, demos, {"env"}) == other
