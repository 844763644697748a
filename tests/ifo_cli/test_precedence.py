"""Modules of the user's that have the names of our packages do not come in our way."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ifo_cli.precedence import put_our_packages_first

ROOT = Path(__file__).parents[2]
IFO = Path(sys.executable).with_name("ifo")
SPAWN = """
import importlib.util, multiprocessing
import ifo_cli

with multiprocessing.get_context("spawn").Pool(1) as pool:
    for name in ("artifacts", "ifo", "stages", "glide"):
        print(pool.apply(importlib.util.find_spec, (name,)).origin)
"""


@pytest.fixture
def folder(tmp_path):
    """A user's folder: a module, a package and a task of their own."""
    (tmp_path / "stages").mkdir()
    for name in ("artifacts.py", "ifo.py", "stages/__init__.py"):
        (tmp_path / name).write_text(f"raise RuntimeError('the user has a {name}')\n")
    (tmp_path / "glide.py").write_text((ROOT / "tests/examples/glide.py").read_text(encoding="utf-8"))
    return tmp_path


def run(folder, *words, path=()):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, [*path, ROOT]))}
    return subprocess.run(
        list(map(str, words)), cwd=folder, env=environment, capture_output=True, text=True, timeout=60
    )


@pytest.mark.parametrize("path", [(), (".",)], ids=["current folder", "PYTHONPATH"])
@pytest.mark.parametrize("program", [(sys.executable, "-m", "ifo_cli"), (IFO,)], ids=["python -m", "ifo"])
def test_the_command_starts(program, path, folder):
    if not Path(program[0]).exists():
        pytest.skip("the `ifo` script is not installed here")
    done = run(folder, *program, "verify", "none.demos.h5", path=path)
    assert (done.returncode, done.stderr.count("\n")) == (3, 1), done.stderr
    assert done.stderr.startswith("ifo: none.demos.h5")


def test_spawned_processes_find_ours_and_the_users_task(folder):
    """`python -m` is not imported again in children; they find modules by the path that they are handed."""
    done = run(folder, sys.executable, "-c", SPAWN, path=["."])
    assert done.stdout.split() == [
        str(ROOT / "artifacts/__init__.py"),
        str(ROOT / "ifo/__init__.py"),
        str(ROOT / "stages/__init__.py"),
        str(folder / "glide.py"),
    ], done.stderr


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (["{user}", "std", "{ours}", "site"], ["std", "{ours}", "{user}", "site"]),
        (["", "std", "{ours}"], ["std", "{ours}", ""]),
        (["{user}", "std"], ["std", "{ours}", "{user}"]),  # An editable install: ours is not on the path.
        (["std", "{ours}", "{user}"], None),
        (["{other}", "std", "{ours}"], None),
    ],
)
def test_order(before, after, folder, tmp_path_factory, monkeypatch):
    names = {"user": folder, "ours": ROOT, "other": tmp_path_factory.mktemp("other")}
    path = [entry.format(**names) for entry in before]
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", path)
    put_our_packages_first(str(ROOT))
    assert path == [entry.format(**names) for entry in (before if after is None else after)]


def test_a_foreign_module_that_is_loaded_is_named(folder, monkeypatch):
    monkeypatch.setattr(sys.modules["artifacts"], "__file__", str(folder / "artifacts.py"))
    with pytest.raises(
        ImportError, match=r"'artifacts' \(.*/artifacts.py\) has the same name as a package of ifo: rename it"
    ):
        put_our_packages_first(str(ROOT))
