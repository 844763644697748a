"""What `pip install` gives a user: the newest versions of everything, outside the repository."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
import time
import zipfile
from functools import cache
from importlib import metadata
from pathlib import Path

import pytest

pytestmark = [pytest.mark.install, pytest.mark.gl]
ROOT = Path(__file__).parents[2]
MINUTES = 15  # for all of this file
PACKAGES = ("artifacts/", "ifo/", "ifo_cli/", "stages/")
# results/ holds the measurements, 18 MB; the others are for work on the repository.
NOT_IN_SDIST = (".git", ".pre-commit-config.yaml", "results/")  # .git: .gitignore and .github/
PIPELINE = (
    "collect-demos reach --preset toy",
    "train-translator",
    "translate",
    "learn-policy",
    "evaluate --json",
)


@cache
def deadline():
    """When all of this must have ended, counted from the first command."""
    return time.monotonic() + 60 * MINUTES


def run(*words, cwd, **variables):
    """Run a command as a user would, whose environment knows nothing of this repository; returns it finished."""
    hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PIP_CONSTRAINT", "IFO_TASKS")
    environment = {name: value for name, value in os.environ.items() if name not in hidden} | variables
    return subprocess.run(
        list(map(str, words)),
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=max(deadline() - time.monotonic(), 1),
    )


def succeed(*words, cwd, **variables):
    done = run(*words, cwd=cwd, **variables)
    assert done.returncode == 0, f"{words}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    return done.stdout


def make_environment(folder):
    """A new virtual environment; returns its Python."""
    succeed(sys.executable, "-m", "venv", "--clear", folder, cwd=folder.parent)
    return folder / "bin/python"


@pytest.fixture(scope="module", autouse=True)
def index(tmp_path_factory):
    """Skip where no package index answers."""
    at = tmp_path_factory.mktemp("index")
    words = ("-m", "pip", "download", "--quiet", "--no-deps", "--retries", "0", "--timeout", "10", "typer", "-d", at)
    done = run(sys.executable, *words, cwd=at)
    if done.returncode:
        pytest.skip(f"no package index answers: {(done.stderr.strip().splitlines() or ['pip failed'])[-1]}")


@pytest.fixture(scope="module")
def sources():
    """The repository's files, those included that are not committed yet."""
    done = run("git", "ls-files", "--cached", "--others", "--exclude-standard", cwd=ROOT)
    if done.returncode:
        pytest.skip("not a git checkout")
    return sorted(name for name in done.stdout.splitlines() if (ROOT / name).is_file())


@pytest.fixture(scope="module")
def built(sources, tmp_path_factory):
    """The sdist, the wheel that is built from it, and the wheel that is built from the repository."""
    at = tmp_path_factory.mktemp("build")
    for name in sources:
        if not name.startswith("results/"):
            (at / "ifo" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, at / "ifo" / name)
    python = make_environment(at / "venv")
    succeed(python, "-m", "pip", "install", "--quiet", "build", cwd=at)
    succeed(python, "-m", "build", "--outdir", at / "dist", "ifo", cwd=at)  # The sdist, and from it the wheel.
    succeed(python, "-m", "build", "--wheel", "--outdir", at / "direct", "ifo", cwd=at)
    [sdist], [wheel], [direct] = (at / "dist").glob("*.tar.gz"), (at / "dist").glob("*.whl"), (at / "direct").glob("*")
    return sdist, wheel, direct


def files_in_wheel(path):
    with zipfile.ZipFile(path) as file:
        return sorted(name for name in file.namelist() if ".dist-info/" not in name)


def test_the_wheel_holds_every_file_of_our_packages(built, sources):
    _, wheel, direct = built
    assert files_in_wheel(wheel) == [name for name in sources if name.startswith(PACKAGES)]
    assert files_in_wheel(direct) == files_in_wheel(wheel)


def test_the_sdist_holds_what_a_builder_needs(built, sources):
    """The repository without its measurements: sources, tests, benchmarks, set-up and pinned versions."""
    with tarfile.open(built[0]) as file:
        names = {member.name.partition("/")[2] for member in file.getmembers() if member.isfile()}
    generated = {name for name in names if name.startswith("ifo.egg-info/")} | {"PKG-INFO", "setup.cfg"}
    assert sorted(names - generated) == [name for name in sources if not name.startswith(NOT_IN_SDIST)]


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory):
    """A new environment with the wheel and the newest versions of what it needs; returns its bin folder.

    Only torch has the version that these tests run with: set-up takes its CPU build on machines without a GPU, and the
    newest one would be a CUDA build of 3 GB.
    """
    at = tmp_path_factory.mktemp("user")
    python = make_environment(at / "venv")
    torch = metadata.version("torch").partition("+")[0]
    succeed(python, "-m", "pip", "install", "--quiet", f"torch=={torch}", cwd=at)
    succeed(python, "-m", "pip", "install", "--quiet", built[1], cwd=at)
    succeed(python, "-m", "pip", "check", cwd=at)
    return python.parent


def test_the_toy_pipeline_runs_from_site_packages(installed, tmp_path):
    path = f"{installed}{os.pathsep}{os.environ['PATH']}"
    where = "import artifacts, ifo_cli, stages; print(artifacts.__file__, ifo_cli.__file__, stages.__file__)"
    for file in succeed(installed / "python", "-c", where, cwd=tmp_path).split():
        assert Path(file).is_relative_to(installed.parent) and "site-packages" in file

    stages = " | ".join(f"ifo {words}" for words in PIPELINE)
    done = run("bash", "-c", f"{stages}; echo ${{PIPESTATUS[@]}} >&2", cwd=tmp_path, PATH=path)
    assert done.stderr.splitlines()[-1] == "0 0 0 0 0", done.stderr[-4000:]
    result = json.loads(done.stdout)
    artifact = Path(tmp_path, result["path"])
    assert artifact.is_file() and artifact.name.endswith(".evaluation.h5")
    succeed("ifo", "verify", *sorted(tmp_path.glob("runs/*.h5")), cwd=tmp_path, PATH=path)

    [video] = tmp_path.glob("runs/*.demos.mp4")
    imported = succeed("ifo", "import-demos", video, "--frames", 5, "--out", "a.demos.h5", cwd=tmp_path, PATH=path)
    assert Path(tmp_path, imported.strip()).is_file()
    assert succeed("python", "-m", "ifo_cli", "--version", cwd=tmp_path, PATH=path).startswith("ifo ")
