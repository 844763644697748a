"""The documentation site: it builds without a warning, and what is generated in it is what the code says."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from importlib import metadata

import pytest

import ifo
from artifacts import IfoError, errors
from tests.docs.pages import DOCS, LINK, PAGES, ROOT, name

MAKE_REFERENCE = DOCS / "make_reference.py"
ABSENT = not (ROOT / "results").is_dir()  # as in a source distribution


def pinned(package: str) -> str:
    found = re.search(rf"^{package}==(.*)$", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.M)
    assert found
    return found[1]


def test_the_generated_pages_are_up_to_date():
    """Other versions of what prints the help may print it differently, but not other words."""
    if any(metadata.version(package) != pinned(package) for package in ("typer", "rich")):
        pytest.skip("the pages are written with the versions in constraints.txt")
    done = subprocess.run([sys.executable, MAKE_REFERENCE, "--check"], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(
    not all(importlib.util.find_spec(module) for module in ("sphinx", "furo", "myst_parser")),
    reason="the extra docs is not installed",
)
@pytest.mark.skipif(ABSENT, reason="pages link to results/")
def test_the_site_builds_without_a_warning(tmp_path):
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-d",
        tmp_path / "trees",
        DOCS,
        tmp_path / "site",
    ]
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    for page in DOCS.rglob("*.md"):
        assert (tmp_path / "site" / page.relative_to(DOCS)).with_suffix(".html").is_file(), f"{page} is not built"
    shown = (tmp_path / "site/reference/python.html").read_text(encoding="utf-8")
    assert 'id="ifo.TranslationReward"' in shown and "Raises" in shown


def test_every_page_is_in_a_table_of_contents():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    listed = {line for block in re.findall(r"```\{toctree\}(.*?)```", index, re.S) for line in block.split()}
    pages = {str(path.relative_to(DOCS).with_suffix("")) for path in DOCS.rglob("*.md")} - {"index"}
    assert pages <= listed


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_to_files(page):
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        path = target.partition("#")[0]
        if "://" not in path and not (ABSENT and "results/" in path):
            assert (page.parent / path).exists(), target


def test_the_python_reference_has_every_public_name():
    text = (DOCS / "reference/python.md").read_text(encoding="utf-8")
    assert [one for one in ifo.__all__ if not re.search(rf"\bifo\.{one}\b", text)] == []


def test_the_exit_codes_are_those_of_the_errors():
    text = (DOCS / "reference/exit-codes.md").read_text(encoding="utf-8")
    listed = {int(code) for code in re.findall(r"^\| (\d+) \|", text, re.M)}
    raised = {one.exit_code for one in vars(errors).values() if isinstance(one, type) and issubclass(one, IfoError)}
    assert listed == raised | {0}
