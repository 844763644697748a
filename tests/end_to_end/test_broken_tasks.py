"""Faults in a user's own task are told as theirs: one line with the place in their file, exit code 2."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ifo_cli.main import main
from stages.simulation.guard import Guard

pytestmark = pytest.mark.gl
EXAMPLES = Path(__file__).parents[1] / "examples"
SOURCE = (EXAMPLES / "broken.py").read_text(encoding="utf-8").splitlines()
SMALL = {
    "train-expert": "--iterations 1 --episodes 4 --test-contexts 2 --test-episodes 2",
    "collect-demos": "-n 10 --keep-failures --contexts narrow",
    "train-translator": "--steps 1 --held-out 2",
    "translate": "-n 2",
    "learn-policy": "--iterations 1 --episodes 4",
    "evaluate": "--episodes 2",
}


def marked_line(kind: str) -> int:
    """The line of a class that is marked as faulty."""
    start = next(k for k, line in enumerate(SOURCE) if line.startswith(f"class {kind}("))
    return next(k for k in range(start, len(SOURCE)) if SOURCE[k].endswith("# here")) + 1


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where all of a task's artifacts lie; its module can be imported."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("broken"))
        patch.syspath_prepend(EXAMPLES)
        patch.setenv("IFO_TASKS", "broken:Sometimes")
        yield Path.cwd()


@pytest.fixture(scope="module")
def artifacts(folder):
    """The input of each stage: what the stages before it made of a task that was not broken yet."""
    expert, demos = folder / "e.expert.h5", folder / "d.demos.h5"
    chain = [
        ("train-expert", "broken:Sometimes", expert),
        ("collect-demos", f"broken:Sometimes --expert {expert}", demos),
        ("train-translator", demos, folder / "t.translator.h5"),
        ("translate", folder / "t.translator.h5", folder / "t.translation.h5"),
        ("learn-policy", folder / "t.translation.h5", folder / "p.policy.h5"),
    ]
    for stage, given, out in chain:
        assert main(f"{stage} {given} --preset toy --workers 1 --quiet {SMALL[stage]} --out {out}".split()) == 0
    return {stage: given for stage, given, _ in chain} | {"evaluate": folder / "p.policy.h5"}


@pytest.fixture
def fails(folder, capsys):
    """A function that runs a command which must fail with exit code 2; its one line of error."""

    def run(stage: str, given: object) -> str:
        capsys.readouterr()
        before = sorted(folder.rglob("*.h5"))
        code = main(f"{stage} {given} --preset toy --workers 1 --quiet {SMALL[stage]} --out x.{stage}.h5".split())
        captured = capsys.readouterr()
        assert (code, captured.out) == (2, ""), captured.err
        assert sorted(folder.rglob("*.h5")) == before
        (line,) = captured.err.splitlines()
        return line

    return run


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("WrongShape", r"distance .* returned an array \(4, 1\), expected \(4,\)"),
        ("ListOfRewards", r"expert_reward .* returned a list, expected an array \(4,\)"),
        ("NotFinite", r"observe_expert .* returned 12 non-finite numbers of 12"),
        ("TypoInContexts", r"distance failed at .*\(KeyError: 'gaol'\)"),
        ("TooFewArguments", r"expert_reward failed at .*TypeError: .*takes 3 positional arguments but 4 were given"),
        ("TypoInMjcf", r"build failed at .*'typ' is not a valid attribute"),
        ("DoesNotCompile", r"build failed at .*mass and inertia"),
        ("BuildsText", r"build failed at .*build returned a str, expected a dm_control.mjcf.RootElement"),
        ("NoMotor", r"build .* has no camera 'context', .* its cameras: none"),
        ("StartsElsewhere", r"draw_states .*, qpos, returned an array \(4, 3\), expected \(4, 2\)"),
        ("HalfTheContexts", r"draw_contexts .* returned\['azimuth'\] an array \(2,\), expected \(4,\)"),
        ("AtTheGoal", r"distance .* starts an episode at distance 0"),
        (
            "NoFactors",
            r"default_factors .* is \('azimuth', 'weather'\), expected a tuple with elements from azimuth, .*goal",
        ),
        ("Abstract", r"cannot be created at .*abstract"),
    ],
)
def test_a_fault_is_told_with_its_place(fails, kind, told):
    line = fails("train-expert", f"broken:{kind}")
    assert line.startswith("ifo: task ") and f"broken:{kind}" in line
    assert f"{EXAMPLES / 'broken.py'}:{marked_line(kind)}" in line
    assert re.search(told, line), line


def test_a_missing_camera_is_told_before_anything_is_trained(fails):
    line = fails("train-expert", "broken:NoCamera")
    assert "has no camera 'wrist', which renders the frames; its cameras: context" in line
    assert re.search(r"build \(.*glide.py:\d+\)", line)  # which the task inherits


def test_a_wrong_field_is_told_when_the_first_frame_is_drawn(fails, artifacts):
    expert = artifacts["collect-demos"].split()[-1]
    import broken

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(broken.Sometimes, "model_fields", broken.NoSuchField.model_fields)
        line = fails("collect-demos", f"broken:Sometimes --expert {expert}")
    assert "returned 'geom_colour', expected array fields of mujoco.MjModel" in line
    assert f"broken.py:{marked_line('NoSuchField')}" in line


@pytest.mark.parametrize(
    ("stage", "method"),
    [
        ("train-expert", "draw_states"),
        ("collect-demos", "observe_expert"),
        ("collect-demos", "model_fields"),
        ("translate", "draw_contexts"),
        ("translate", "context_state"),
        ("learn-policy", "observe"),
        ("learn-policy", "model_fields"),
        ("evaluate", "draw_states"),
        ("evaluate", "distance"),
    ],
)
def test_an_exception_in_any_stage_is_the_tasks(fails, artifacts, monkeypatch, stage, method):
    monkeypatch.setattr("broken.FAULT", method)
    line = fails(stage, artifacts[stage])
    place = f"{EXAMPLES / 'broken.py'}:{marked_line('Sometimes')}"
    assert line == (
        f"ifo: task broken:Sometimes: {method} failed at {place} (ZeroDivisionError: half of nothing); check the whole "
        "task with: ifo check-task broken:Sometimes"
    )


def test_a_fault_of_a_built_in_task_is_a_bug(folder, monkeypatch, capsys):
    def fail(*arguments):
        raise ZeroDivisionError("half of nothing")

    monkeypatch.setattr("stages.simulation.tasks.reach.Reach.distance", fail)
    assert main(f"train-expert reach --preset toy --workers 1 {SMALL['train-expert']}".split()) == 1
    message = capsys.readouterr().err
    assert "Traceback" in message and "this is a bug in ifo" in message


def test_the_guard_passes_for_the_task(folder):
    from glide import Glide

    from stages.simulation.registry import code_digest, make_task
    from stages.simulation.task import Task

    task = make_task("glide:Glide", typed=True)
    assert type(task) is Guard
    assert isinstance(task, Glide) and isinstance(task, Task)
    task.own = 3
    task.substeps = 2
    assert (task.own, task.control_timestep) == (3, pytest.approx(0.02))
    assert not hasattr(task, "nothing")
    assert code_digest(task) == code_digest(Glide()) != {}  # Whose code decides whether artifacts are up to date.
