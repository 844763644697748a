"""Tasks by name, built in and brought by users; what varies; what a task changes in a preset."""

from __future__ import annotations

import sys
import textwrap

import numpy as np
import pytest

from artifacts import UsageError
from stages.config.presets import defaults
from stages.config.stages import HOUSEHOLD, TASKS
from stages.config.task_names import TRUSTED, known_tasks, permission_needed
from stages.simulation.checking import check_task
from stages.simulation.contexts import FACTORS
from stages.simulation.registry import distribution, file_name, make_task
from stages.simulation.tasks.dm import DmTask
from stages.simulation.tasks.push import Push
from stages.simulation.tasks.reach import Reach
from stages.simulation.tasks.strike import Strike
from stages.simulation.tasks.sweep import Sweep

MODULE = """
    from stages.simulation.tasks.reach import Reach

    class Slow(Reach):
        name = "slow"
        substeps = 10

    def brisk():
        task = Reach()
        task.substeps = 2
        return task

    ready = Slow()
    number = 3
    WhatIsThis = dict
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module that a user wrote; its name. Nothing trusts it yet."""
    (tmp_path / "brought_tasks.py").write_text(textwrap.dedent(MODULE))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv(TRUSTED, raising=False)
    yield "brought_tasks"
    sys.modules.pop("brought_tasks", None)


@pytest.mark.parametrize(("name", "kind"), list(zip(TASKS, (Reach, Push, Sweep, Strike), strict=True)))
def test_the_papers_tasks_are_built_in(name, kind):
    for typed in (False, True):
        task = make_task(name, typed)
        assert type(task) is kind
        assert task.name == name


@pytest.mark.gl
@pytest.mark.parametrize("name", [*TASKS, *HOUSEHOLD, "dm:reacher-easy", "dm:point_mass-easy"])
def test_built_in_tasks_keep_every_promise(name):
    report = check_task(make_task(name))
    assert report.problems == ()
    assert report.frames.shape == (20, *make_task(name).frame_size, 3)


def test_the_suites_tasks_need_no_trust(monkeypatch):
    monkeypatch.delenv(TRUSTED, raising=False)
    task = make_task("dm:cheetah-run", typed=False)
    assert isinstance(task, DmTask)
    assert task.name == "dm:cheetah-run"


@pytest.mark.parametrize("typed", [False, True])
def test_unknown_names_are_usage_errors_that_list_the_choices(typed):
    with pytest.raises(
        UsageError, match=r"'walk': expected one of reach, push, .*ladle-almonds, dm:.*, or MODULE:ATTR"
    ):
        make_task("walk", typed)
    with pytest.raises(UsageError, match="no task 'raech', did you mean reach"):
        make_task("raech", typed)


@pytest.mark.parametrize(("attribute", "substeps"), [("Slow", 10), ("brisk", 2), ("ready", 10)])
def test_a_class_a_function_or_a_task_that_the_user_typed_is_made(module, attribute, substeps):
    task = make_task(f"{module}:{attribute}", typed=True)
    assert isinstance(task, Reach)
    assert task.substeps == substeps
    assert task.control_timestep == pytest.approx(0.01 * substeps)
    assert task.name == f"{module}:{attribute}"  # what later stages find it by


def test_code_that_a_file_names_is_not_run(module, tmp_path):
    marker = tmp_path / "ran"
    (tmp_path / "stranger.py").write_text(f"open({str(marker)!r}, 'w')\n")
    with pytest.raises(UsageError, match=f"export {TRUSTED}=stranger:Task"):
        make_task("stranger:Task")
    assert not marker.exists()


def test_code_that_the_environment_trusts_is_run(module, monkeypatch):
    name = f"{module}:Slow"
    monkeypatch.setenv(TRUSTED, f"elsewhere:Task,{name}")
    assert make_task(name).name == name
    with pytest.raises(UsageError, match=f"export {TRUSTED}="):
        make_task(f"{module}:brisk")


@pytest.mark.parametrize(("attribute", "found"), [("number", "int"), ("WhatIsThis", "dict")])
def test_what_is_no_task_is_a_usage_error(module, attribute, found):
    with pytest.raises(UsageError, match=f"is a {found}, expected"):
        make_task(f"{module}:{attribute}", typed=True)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("brought_tasks:Missing", "has no Missing"),
        ("no_such_module:Task", "on PYTHONPATH"),
        ("brought_tasks:", "expected MODULE:ATTR"),
        (":Task", "expected MODULE:ATTR"),
        (".brought_tasks:Task", "expected MODULE:ATTR"),
        ("math:sqrt", "cannot be created"),
    ],
)
def test_what_cannot_be_imported_is_a_usage_error(module, name, told):
    with pytest.raises(UsageError, match=told):
        make_task(name, typed=True)


def test_faults_in_a_users_module_are_told_in_one_line(module, tmp_path):
    (tmp_path / "broken_tasks.py").write_text("def build(:\n")
    with pytest.raises(UsageError, match="SyntaxError") as caught:
        make_task("broken_tasks:Task", typed=True)
    assert "\n" not in str(caught.value)


def test_an_installed_package_gives_its_task_a_name(module, tmp_path):
    """What a user installs is trusted: no file can install anything."""
    info = tmp_path / "brought-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: brought\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        f"[ifo.tasks]\nslow = {module}:Slow\nwrong = {module}:number\nlost = {module}:Missing\n"
    )
    task = make_task("slow")
    assert task.substeps == 10
    assert task.name == "slow"
    with pytest.raises(UsageError, match="is a int, expected"):
        make_task("wrong")
    with pytest.raises(UsageError, match="cannot be created"):
        make_task("lost")
    assert set(known_tasks()) >= {"reach", "push-real", "slow", "wrong", "lost"}
    assert permission_needed("slow") == ""
    with pytest.raises(UsageError, match="did you mean slow"):
        make_task("slwo")


def test_a_task_that_later_stages_may_not_import_is_told(monkeypatch):
    monkeypatch.setenv(TRUSTED, "mine:Task")
    for name in ("", "reach", "dm:cheetah-run", "mine:Task"):
        assert permission_needed(name) == ""
    assert permission_needed("other:Task").endswith(f"export {TRUSTED}=other:Task")


def test_file_names_hold_no_separators():
    assert file_name("dm:reacher-easy") == "dm-reacher-easy"
    assert file_name("a/b:C") == "a-b-C"


def test_a_distribution_varies_what_is_asked_for():
    assert distribution("paper").vary is None
    assert distribution("narrow", "azimuth, goal").vary == {"azimuth", "goal"}
    assert distribution("narrow", "goal").azimuth == distribution("narrow").azimuth
    assert distribution("fixed", ",".join(FACTORS)).vary == set(FACTORS)


def test_an_unknown_factor_is_a_usage_error():
    with pytest.raises(UsageError, match="--vary 'weather': expected a comma-separated choice of azimuth, elevation"):
        distribution("paper", "azimuth,weather")


@pytest.mark.parametrize(
    ("name", "factor"),
    [("sweep", "distractors"), ("sweep", "goal"), ("strike", "distractors"), ("dm:cheetah-run", "goal")],
)
def test_a_factor_that_the_task_lacks_is_a_usage_error(name, factor):
    drawn_from = distribution("paper", f"azimuth,{factor}")
    with pytest.raises(UsageError, match=f"--vary {factor}: expected factors of {name}: azimuth, elevation"):
        make_task(name).draw_contexts(np.random.default_rng(0), 1, drawn_from)


def test_a_task_changes_its_preset_only_where_it_says_so():
    for stage in ("train-expert", "collect-demos", "learn-policy"):
        for task in ("", "reach", "somebody:Task", "pusher"):
            assert defaults("quick", stage, task) == defaults("quick", stage)
    assert defaults("quick", "collect-demos", "push") == defaults("quick", "collect-demos")


@pytest.mark.parametrize("preset", ["quick", "paper"])
def test_hard_tasks_give_their_experts_longer(preset):
    usual = defaults(preset, "train-expert", "reach")
    for task in ("push", "sweep", "strike"):
        config = defaults(preset, "train-expert", task)
        assert config.iterations > usual.iterations
        assert (config.learner, config.gae_lambda) == (usual.learner, usual.gae_lambda)


@pytest.mark.parametrize("preset", ["toy", "quick", "paper"])
def test_the_suites_experts_learn_by_sac(preset):
    config = defaults(preset, "train-expert", "dm:walker-walk")
    assert config.learner == "sac"
    assert config.episodes < defaults(preset, "train-expert", "reach").episodes  # An episode has 1000 steps, not 50.


def test_toys_stay_toys():
    for task in TASKS:
        assert defaults("toy", "train-expert", task) == defaults("toy", "train-expert")
    for stage in ("train-expert", "learn-policy"):
        toy, quick = defaults("toy", stage, "dm:walker-walk"), defaults("quick", stage, "dm:walker-walk")
        assert toy.iterations * toy.episodes < 0.1 * quick.iterations * quick.episodes
