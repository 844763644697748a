"""Tasks bring their own defaults: ours without a simulator being imported, those of users from their code."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from artifacts import UsageError
from stages.config.presets import PRESETS, defaults, resolve
from stages.config.stages import HOUSEHOLD, TASKS
from stages.config.tasks import ENTRIES
from stages.config.values import checked_defaults
from stages.simulation.registry import known_defaults, make_task, task_defaults

ROOT = Path(__file__).parents[3]
GLIDE = """
from tests.examples.glide import Glide as Plain

class Glide(Plain):
    defaults = {defaults}
"""
OWN = {
    "toy": {"collect-demos": {"n": 24}, "learn-policy": {"kl": 0.5, "gps": {"kl": 2.0}}},
    "quick": {"train-translator": {"without": ["align"]}},
}


@pytest.fixture
def users_task(tmp_path, monkeypatch):
    """A function that writes a module with a task of these defaults, and returns its name."""

    def write(module, own):
        (tmp_path / f"{module}.py").write_text(GLIDE.format(defaults=repr(own)))
        monkeypatch.syspath_prepend(tmp_path)
        return f"{module}:Glide"

    return write


@pytest.mark.parametrize("name", ENTRIES)
def test_the_class_of_a_task_has_the_defaults_of_its_entry(name):
    task = make_task("dm:reacher-easy" if name == "dm:" else name, typed=True)
    assert task.defaults is ENTRIES[name].defaults
    assert name == "dm:" or task.name == name
    assert name == "dm:" or (task.demonstrator is not None) == ENTRIES[name].household
    assert checked_defaults(task.defaults) == task.defaults


def test_the_lists_of_tasks_derive_from_the_entries():
    assert (*TASKS, *HOUSEHOLD, "dm:") == tuple(ENTRIES)


def test_defaults_of_ours_import_no_simulator():
    code = (
        "import sys; from stages.config.presets import defaults; print(defaults('quick', 'learn-policy', 'push-real'));"
        "print([m for m in ('torch', 'mujoco', 'numpy', 'h5py') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_users_task_brings_its_own(users_task):
    name = users_task("gliding_well", OWN)
    own = task_defaults(name, typed=True)
    assert defaults("toy", "collect-demos", name, own=own).n == 24
    assert defaults("toy", "learn-policy", name, own=own).kl == 0.5
    assert defaults("toy", "learn-policy", name, "gps", own=own).kl == 2.0, "with this learner"
    assert defaults("quick", "train-translator", name, own=own).without == ("align",)
    assert defaults("quick", "learn-policy", name, own=own) == PRESETS["quick"]["learn-policy"]
    assert resolve("collect-demos", "toy", name, own=own).origins["n"] == f"task {name}"


def test_a_users_task_is_not_imported_because_a_file_names_it(users_task, monkeypatch):
    name = users_task("gliding_unseen", {"quik": {}})
    assert known_defaults(name) == {} and known_defaults("push") is ENTRIES["push"].defaults
    with pytest.raises(UsageError, match="IFO_TASKS"):
        task_defaults(name)
    monkeypatch.setenv("IFO_TASKS", f"other:Task, {name}")
    with pytest.raises(UsageError, match="quik"):
        task_defaults(name)


@pytest.mark.parametrize(
    ("module", "own", "expected"),
    [
        ("glide_a", {"quik": {}}, "['quik']: expected quick"),
        ("glide_b", {"quick": {"collect": {}}}, "['quick']['collect']: expected collect-demos"),
        ("glide_c", {"quick": {"evaluate": {"episode": 3}}}, "['episode']: expected episodes"),
        ("glide_d", {"quick": {"evaluate": {"episodes": "3"}}}, "['episodes']: expected a whole number"),
        ("glide_e", {"quick": {"evaluate": {"episodes": 0}}}, "['episodes']: expected 1 or more"),
        ("glide_f", {"quick": {"learn-policy": {"gsp": {"kl": 1.0}}}}, "['gsp']: expected"),
        ("glide_g", {"quick": {"learn-policy": {"gps": {"blurr": 1.0}}}}, "['gps']['blurr']: expected blur"),
        ("glide_h", {"quick": 3}, "['quick']: expected a mapping"),
        ("glide_i", 3, "expected a mapping"),
    ],
)
def test_defaults_that_make_no_sense_are_an_error_of_the_users_file(users_task, tmp_path, module, own, expected):
    with pytest.raises(UsageError) as caught:
        task_defaults(users_task(module, own), typed=True)
    message = str(caught.value)
    assert f"defaults ({tmp_path / module}.py:4) " in message and expected in message and "\n" not in message
