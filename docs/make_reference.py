"""Write the generated pages of the reference, docs/reference/cli.md and artifacts.md, from the code.

    python docs/make_reference.py

A test compares the committed pages with what this script would write.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

WIDTH = "96"  # columns of the help texts
# Before typer is imported, which reads them. Help texts are as they are in a terminal without colors.
os.environ |= {"COLUMNS": WIDTH, "TERMINAL_WIDTH": WIDTH, "NO_COLOR": "1", "TERM": "dumb"}
for name in ("FORCE_COLOR", "PY_COLORS", "GITHUB_ACTIONS"):
    os.environ.pop(name, None)

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent))

from artifacts.kinds import KINDS, SCHEMA, DatasetSpec  # noqa: E402
from artifacts.pipeline import STAGE_FILES  # noqa: E402
from artifacts.schema import Manifest, Parent  # noqa: E402
from ifo_cli.main import app, main  # noqa: E402

NOTE = "% Written by `python docs/make_reference.py`: change the code, then run it again.\n\n"


def help_of(*command: str) -> str:
    """Return the help text of `ifo` or of one of its commands."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        code = main([*command, "--help"])
    if code:
        raise SystemExit(f"ifo {' '.join(command)} --help ended with exit code {code}")
    lines = [line.rstrip().removeprefix(" ") for line in out.getvalue().splitlines()]
    return "\n".join(lines).strip("\n")


def cli_page() -> str:
    """Return the page with the help text of every command."""
    parts = [
        f"{NOTE}# Command-line help\n\nWhat `ifo COMMAND --help` prints. [Commands](commands.md) is an overview.",
        f"```text\n{help_of()}\n```",
    ]
    for command in app.registered_commands:
        assert command.name
        parts.append(f"## ifo {command.name}\n\n```text\n{help_of(command.name)}\n```")
    return "\n\n".join(parts) + "\n"


def attributes_of(model: type) -> list[tuple[str, ...]]:
    """Return the names and descriptions in the section `Attributes:` of a class's docstring."""
    section = (model.__doc__ or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    items = (" ".join(item.split()).partition(": ") for item in re.split(r"\n      (?=\w+: )", "\n" + section))
    return [(f"`{name}`", about) for name, _, about in items if name]


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Return a Markdown table."""
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


def dataset_rows(specs: Mapping[str, DatasetSpec], presence: str) -> Iterator[tuple[str, ...]]:
    names = {"f": "float", "i": "integer", "u": "unsigned integer", "b": "boolean"}
    for name, spec in specs.items():
        dtypes = " or ".join(names.get(dtype, dtype) for dtype in spec.dtypes) or "any"
        shape = "any" if spec.axes is None else "scalar" if not spec.axes else f"({', '.join(map(str, spec.axes))})"
        yield f"`{name}`", dtypes, shape, presence, "yes" if spec.finite else ""


def artifacts_page() -> str:
    """Return the page with the schema of every kind of artifact."""
    parts = [
        f"{NOTE}# Artifact schemas\n\nAn artifact is one HDF5 file, `NAME.KIND.h5`. This is schema version {SCHEMA}, "
        "which is written; older versions are migrated when they are read. [Artifacts and lineage]"
        "(../concepts/artifacts.md) says what the files promise.",
        "## Root attributes\n\nThey are the same for every kind. Mappings and lists are stored as JSON.\n\n"
        + table(
            ("Attribute", "Content"), [(f"`{name}`", about) for name, about in attributes_of(Manifest.__doc__ or "")]
        )
        + "\n\nEach of `parents` has:\n\n"
        + table(("Key", "Content"), attributes_of(Parent)),
        "## Datasets\n\nThe same name of an axis means the same length throughout a file. A name that ends in `/*` "
        "stands for every dataset in that group. A file may hold more datasets than these.",
    ]
    stages: dict[str, list[str]] = {}
    for stage, files in STAGE_FILES.items():
        stages.setdefault(files.writes, []).append(f"`ifo {stage}`")
    for kind, spec in KINDS.items():
        rows = [*dataset_rows(spec.datasets, "required"), *dataset_rows(spec.optional, "optional")]
        written = f"Written by {' and '.join(stages[kind])}." if kind in stages else "Written by long-running stages."
        columns = ("Dataset", "Type", "Shape", "Presence", "Must be finite")
        parts.append(f"### {kind}\n\n{written}\n\n{table(columns, rows)}")
    return "\n\n".join(parts) + "\n"


PAGES: dict[str, Callable[[], str]] = {"reference/cli.md": cli_page, "reference/artifacts.md": artifacts_page}


def differing() -> list[str]:
    """Return the names of the pages that are not what this script would write."""
    return [name for name, make in PAGES.items() if not (DOCS / name).is_file() or (DOCS / name).read_text() != make()]


if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        if wrong := differing():
            sys.exit(f"not up to date: {', '.join(wrong)}: run python docs/make_reference.py")
    else:
        for name, make in PAGES.items():
            (DOCS / name).write_text(make())
