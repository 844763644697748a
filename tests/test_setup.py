"""What .ci/setup.sh does where pip or rendering fails, and that the packages for rendering are listed once."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from stages.simulation import gl

ROOT = Path(__file__).parent.parent
REASON = "no OpenGL backend works here (EGL: PyOpenGL cannot find libOpenGL.so.0); on Debian run `apt-get install`"

# Stands in for .venv/bin/python; `renders` is how often the probe fails before it succeeds.
PYTHON = """#!/usr/bin/env bash
case "$*" in
    *version_info*) exit "${UNSUITED:-0}" ;;
    --version) echo "Python 3.13.0" ;;
    "-m pip install"*) echo "$*" >> pip.log; echo "WARNING: of pip"; exit "${PIP_STATUS:-0}" ;;
    *choose_backend*)
        failures=$(cat failures)
        [ "$failures" = 0 ] && exit
        echo $((failures - 1)) > failures
        echo "Traceback of a library" >&2
        echo "$REASON" >&2
        exit 1 ;;
    *PACKAGES*) echo one two ;;
esac
"""
APT = """#!/usr/bin/env bash
echo "$*" >> apt.log
echo "debconf: delaying package configuration" >&2
exit "${APT_STATUS:-0}"
"""


# Stands in for an interpreter of which `make` is told, or which lies on the PATH.
OTHER_PYTHON = """#!/bin/sh
case "$*" in
    *version_info*) exit 1 ;;
    --version) echo "Python 3.13.0" ;;
    *) exit 1 ;;
esac
"""


@pytest.fixture
def set_up(tmp_path, monkeypatch):
    """Runs .ci/setup.sh in a folder of its own, on a machine where rendering fails `failures` times."""
    shutil.copytree(ROOT / ".ci", tmp_path / ".ci")
    (tmp_path / "constraints.txt").write_text("torch==1.0\n")
    programs = {
        ".venv/bin/python": PYTHON,
        "bin/apt-get": APT,
        "bin/nvidia-smi": "#!/bin/sh\n",  # So that no index is asked for a build of torch for the CPU.
        "bin/id": "#!/bin/sh\necho ${USER_ID:-0}\n",
    }
    for name, text in programs.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        path.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("REASON", REASON)

    def run(failures, **variables):
        (tmp_path / "failures").write_text(str(failures))
        return subprocess.run(
            ["bash", ".ci/setup.sh"],
            cwd=tmp_path,
            env=os.environ | variables,
            capture_output=True,
            text=True,
            timeout=60,
        )

    return run


def log(tmp_path, name):
    path = tmp_path / f"{name}.log"
    return path.read_text().splitlines() if path.exists() else []


def test_setup_succeeds_where_rendering_works(set_up, tmp_path):
    done = set_up(failures=0)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / ".venv/.stamp").exists()
    assert log(tmp_path, "apt") == []
    assert done.stderr == "setup: installing ifo and its dependencies\n"  # Neither pip's nor apt's own messages.


def test_setup_installs_the_packages_that_rendering_needs(set_up, tmp_path):
    done = set_up(failures=1)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / ".venv/.stamp").exists()
    assert log(tmp_path, "apt")[-1].endswith(" one two")
    assert done.stderr.splitlines()[1:] == ["setup: installing one two for rendering"]


def test_setup_fails_where_rendering_still_does_not_work(set_up, tmp_path):
    done = set_up(failures=2)
    assert done.returncode == 4
    assert not (tmp_path / ".venv/.stamp").exists()
    assert done.stderr.splitlines()[-1] == f"setup: {REASON}; then run `make setup` again"
    assert "Traceback" not in done.stderr


def test_setup_installs_nothing_on_debian_without_being_root(set_up, tmp_path):
    done = set_up(failures=1, USER_ID="1000")
    assert done.returncode == 4
    assert not (tmp_path / ".venv/.stamp").exists()
    assert log(tmp_path, "apt") == []
    assert REASON in done.stderr


def test_setup_shows_why_apt_failed(set_up, tmp_path):
    done = set_up(failures=2, APT_STATUS="100")
    assert done.returncode == 4
    assert "debconf: delaying" in done.stderr
    assert done.stderr.splitlines()[-1].startswith(f"setup: {REASON}")


def write_program(path, text):
    path.write_text(text)
    path.chmod(0o755)
    return path


def test_setup_refuses_a_python_that_is_too_new(set_up, tmp_path):
    """Instead of a resolution that fails after minutes: not every package has a wheel for it."""
    python = write_program(tmp_path / "bin/python9", OTHER_PYTHON)
    done = set_up(failures=0, UNSUITED="1", PYTHON=str(python))
    assert done.returncode == 4
    assert done.stderr == f"setup: PYTHON={python} is Python 3.13.0: ifo needs Python 3.11 or 3.12\n"


def test_setup_says_which_python_is_missing(set_up, tmp_path):
    for name in ("python3", "python3.12", "python3.11"):
        write_program(tmp_path / "bin" / name, OTHER_PYTHON)
    done = set_up(failures=0, UNSUITED="1", USER_ID="1000")
    assert done.returncode == 4
    assert done.stderr.startswith("setup: ifo needs Python 3.11 or 3.12, found Python 3.13.0: install one, or name it:")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(("version", "suits"), [("(3, 10, 9)", 0), ("(3, 11)", 1), ("(3, 12, 9)", 1), ("(3, 13)", 0)])
def test_setup_takes_the_pythons_of_the_package(version, suits, tmp_path):
    """Read from the script itself: what it runs in the interpreter, on another version."""
    script = (ROOT / ".ci/setup.sh").read_text()
    [program] = re.findall(r"suits\(\) \{ \"\$1\" -c '(.*?)'", script)
    done = subprocess.run([sys.executable, "-c", program.replace("sys.version_info", version)], timeout=60)
    assert done.returncode == (not suits)


def test_setup_fails_where_pip_fails(set_up, tmp_path):
    done = set_up(failures=0, PIP_STATUS="1")
    assert done.returncode == 4
    assert not (tmp_path / ".venv/.stamp").exists()
    assert done.stderr.splitlines()[-2:] == [
        "WARNING: of pip",
        "setup: pip cannot install the packages (see its messages above)",
    ]


def test_old_source_distributions_are_built_by_the_supported_route(set_up, tmp_path):
    set_up(failures=0)
    installs = log(tmp_path, "pip")
    assert installs and all("--use-pep517" in line for line in installs)


def test_the_packages_for_rendering_are_listed_once():
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    texts = {
        name: (ROOT / name).read_text(errors="replace")
        for name in tracked.splitlines()
        if Path(name).suffix in ("", ".md", ".py", ".sh", ".toml", ".txt", ".yml") and (ROOT / name).is_file()
    }
    naming = {name for name, text in texts.items() if any(package in text for package in gl.PACKAGES)}
    assert {name for name in naming if not name.startswith("tests/")} - {"CHANGELOG.md"} == {
        "stages/simulation/gl.py",
        "docs/get-started.md",  # for readers; it says what gl.py says:
    }
    assert f"`{gl.INSTALL}`" in texts["docs/get-started.md"]
