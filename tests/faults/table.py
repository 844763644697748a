"""results/faults.md: one section per command that writes a part of it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOUND = Path(__file__).with_name("found.toml")
TITLE = "Faults and hostile files"
SECTIONS = ("Injections", "Fuzzing", "Faults found")


def write_section(path: Path, name: str, text: str) -> None:
    """Replace a section of the page, and the list of faults found; other sections stay."""
    sections = read_sections(path) | {name: text.strip(), "Faults found": found_text()}
    parts = [f"# {TITLE}", *(f"## {name}\n\n{sections[name]}" for name in SECTIONS if name in sections)]
    path.write_text("\n\n".join(parts) + "\n")


def read_sections(path: Path) -> dict[str, str]:
    """Return the sections of the page by name; none if there is no page."""
    text = path.read_text() if path.exists() else ""
    names, bodies = re.findall(r"^## (.*)$", text, re.M), re.split(r"^## .*$", text, flags=re.M)[1:]
    return {name: body.strip() for name, body in zip(names, bodies, strict=True)}


def found() -> list[dict[str, str]]:
    """Return the faults that were found so far: `fault` says what happened, `test` names the test that notices it."""
    return list(tomllib.loads(FOUND.read_text())["found"])


def found_text() -> str:
    """Return the list of faults as Markdown."""
    rows = [f"| {one['fault']} | `{one['test'].removeprefix('tests/')}` |" for one in found()]
    head = "What fault injection, fuzzing and hostile files brought to light. Each fault is fixed, and has a test."
    return "\n".join([head, "", "| Fault | Test, in tests/ |", "|---|---|", *rows])
