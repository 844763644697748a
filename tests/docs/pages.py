"""The pages that people read, and the commands and snippets in them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
GENERATED = ("reference/cli.md", "reference/artifacts.md")  # by docs/make_reference.py
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(path for path in DOCS.rglob("*.md") if str(path.relative_to(DOCS)) not in GENERATED),
]
FENCE = re.compile(r"^([ ]*)```([^\n]*)\n(.*?)^\1```$", re.S | re.M)
SPAN = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
LINK = re.compile(r"\]\(([^)\s]+)\)")


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def blocks(page: Path, language: str) -> list[str]:
    """The fenced code blocks of a page in a language, without their indentation."""
    text = page.read_text(encoding="utf-8")
    return [
        re.sub(rf"^{indent}", "", code, flags=re.M)
        for indent, kind, code in FENCE.findall(text)
        if kind.strip() == language
    ]


def prose(page: Path) -> str:
    """A page without its code blocks."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def lines(page: Path) -> Iterator[str]:
    """The command lines in a page's blocks of shell code."""
    for block in blocks(page, "sh"):
        for line in block.replace("\\\n", " ").splitlines():
            if line.strip() and not line.lstrip().startswith("#"):
                yield line.strip()


def commands(line: str) -> list[list[str]]:
    """The commands of a command line, which are joined by pipes, as words."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;<>")
    lexer.whitespace_split = True
    found: list[list[str]] = [[]]
    for word in lexer:
        if word == "|":
            found.append([])
        else:
            assert not set(word) & set("&;<>"), f"{line}: expected one command, or commands joined by pipes"
            found[-1].append(word)
    return found
