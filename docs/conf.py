"""Configuration of the documentation site: `make docs`."""

from __future__ import annotations

import posixpath
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = PROJECT["name"]
author = copyright = PROJECT["authors"][0]["name"]
version = release = PROJECT["version"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = project
exclude_patterns = ["_build", "images"]
nitpicky = False  # Types in signatures are those of libraries, whose documentation is not at hand offline.

myst_heading_anchors = 3
smartquotes = False  # They would make a dash of the two hyphens of an option.
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

# Links that leave docs/ work on GitHub. On the site they lead to the repository if pyproject.toml says where it is, and
# otherwise to a copy of the file.
REPOSITORY = PROJECT.get("urls", {}).get("Repository", "")
properties: dict[str, list[str]] = {}  # docstrings of properties
LINK = re.compile(r"\[([^\]\[]+)\]\((\.\./[^)#\s]+)\)")


def link_outside(folder: str, text: str) -> str:
    """Replace the links of a page in `folder` of docs/ to files that are not part of the site."""

    def replaced(found: re.Match[str]) -> str:
        label, target = found.groups()
        path = posixpath.normpath(posixpath.join("docs", folder, target))
        if path.startswith("docs/"):
            return found[0]
        return f"[{label}]({REPOSITORY}/blob/main/{path})" if REPOSITORY else f"{{download}}`{label} <{target}>`"

    return LINK.sub(replaced, text)


def on_source_read(app, docname: str, source: list[str]) -> None:
    source[0] = link_outside(posixpath.dirname(docname), source[0])


def on_docstring(app, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Turn a docstring of plain text into reStructuredText: `code`, (n, *shape), and examples that follow a colon."""
    for at, line in enumerate(lines):
        example = line.endswith(":") and lines[at + 1 : at + 2] == [""] and lines[at + 2][:1] == " "
        indented = line.startswith(" ") and at > 1 and not lines[at - 1] and lines[at - 2].endswith("::")
        if not indented:
            line = re.sub(r"(?<!`)`([^`]+)`(?!`)", r"``\1``", line)
            line = re.sub(r"\*(?=\w)(?![^`]*``)", r"\\*", line)
        lines[at] = f"{line}:" if example else line
    if what == "property":
        properties[name] = list(lines)


def after_napoleon(app, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Restore the docstring of a property: napoleon takes what comes before a colon in it for a type."""
    if what == "property":
        lines[:] = properties[name]


def setup(app) -> None:
    app.connect("source-read", on_source_read)
    app.connect("autodoc-process-docstring", on_docstring, priority=100)
    app.connect("autodoc-process-docstring", after_napoleon, priority=900)
