"""What pip is told agrees with what lies in the repository."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from ifo_cli.doctor import PYTHONS

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = [ROOT / name for name in ("artifacts", "ifo", "ifo_cli", "stages") if (ROOT / name).is_dir()]


def package_files():
    return [
        path
        for package in PACKAGES
        for path in sorted(package.rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts
    ]


def test_every_folder_with_modules_is_a_package():
    """pip installs no folder without an __init__.py, although a checkout imports it."""
    folders = {path.parent for path in package_files() if path.suffix == ".py"}
    assert [str(folder) for folder in sorted(folders) if not (folder / "__init__.py").is_file()] == []


def test_every_package_is_installed():
    patterns = PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]
    assert [package.name for package in PACKAGES if f"{package.name.partition('_')[0]}*" not in patterns] == []


def test_every_other_file_of_a_package_is_package_data():
    data = PROJECT["tool"]["setuptools"]["package-data"]
    others = [path for path in package_files() if path.suffix != ".py"]
    assert others, "no file to look at"
    for path in others:
        package = next(folder for folder in path.parents if (folder / "__init__.py").is_file())
        patterns = data.get(".".join(package.relative_to(ROOT).parts), [])
        assert path in {found for pattern in patterns for found in package.glob(pattern)}, f"{path} is not installed"


def test_python_versions_are_the_same_everywhere():
    named = [f"{major}.{minor}" for major, minor in PYTHONS]
    spoken = f"Python {' or '.join(named)}"
    major, minor = PYTHONS[-1]
    assert PROJECT["project"]["requires-python"] == f">={named[0]},<{major}.{minor + 1}"
    prefix = "Programming Language :: Python :: "
    classified = [line.removeprefix(prefix) for line in PROJECT["project"]["classifiers"] if line.startswith(prefix)]
    assert classified == ["3 :: Only", *named]
    for name in ("README.md", "docs/get-started.md", ".ci/setup.sh"):
        assert spoken in (ROOT / name).read_text(encoding="utf-8"), name


def test_pinned_versions_are_ones_that_pip_may_install():
    """constraints.txt is what the tests run with; the lower bounds must admit it."""
    packaging = pytest.importorskip("packaging.requirements")
    from packaging.utils import canonicalize_name

    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = dict(line.split("==") for line in lines if not line.startswith("#"))
    pinned = {canonicalize_name(name): version for name, version in pinned.items()}
    extras = PROJECT["project"]["optional-dependencies"]
    for text in [*PROJECT["project"]["dependencies"], *(text for texts in extras.values() for text in texts)]:
        requirement = packaging.Requirement(text)
        if requirement.name != "ifo":
            assert requirement.specifier.contains(pinned[canonicalize_name(requirement.name)]), text
