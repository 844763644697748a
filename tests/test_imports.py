"""Imports go one way: ifo_cli -> stages -> artifacts, and in stages/ from stages to what they share."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PARTS = ("footage", "datasets", "simulation", "translation", "rewards", "learners", "reporting")
STAGE_MODULES = (
    "train_expert",
    "collect_demos",
    "import_demos",
    "export_demos",
    "train_translator",
    "translate",
    "learn_policy",
    "evaluate",
    "report",
)


def files(folder):
    return sorted((ROOT / folder).rglob("*.py"))


def imported(path):
    """Every module that a file imports, wherever in the file, `from a import b` giving a and a.b."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(ROOT).with_suffix("").parts[: -node.level] if node.level else ()
            module = ".".join([*package, *([node.module] if node.module else [])])
            found.add(module)
            found.update(f"{module}.{name.name}" for name in node.names)
    return found


def offenders(folder, forbidden):
    return [
        f"{path.relative_to(ROOT)} imports {module}"
        for path in files(folder)
        for module in sorted(imported(path))
        if any(module == name or module.startswith(f"{name}.") for name in forbidden)
    ]


def test_there_is_something_to_look_at():
    for folder in ("artifacts", "stages", "ifo_cli", *(f"stages/{part}" for part in PARTS)):
        assert len(files(folder)) > 1, folder


def test_artifacts_know_nothing_of_stages_or_commands():
    assert offenders("artifacts", ["stages", "ifo_cli"]) == []


def test_stages_know_nothing_of_commands():
    assert offenders("stages", ["ifo_cli"]) == []


def test_simulation_imports_no_other_part():
    others = [f"stages.{part}" for part in PARTS if part != "simulation"]
    assert offenders("stages/simulation", others) == []


@pytest.mark.parametrize("part", PARTS)
def test_parts_import_no_stage(part):
    assert offenders(f"stages/{part}", [f"stages.{module}" for module in STAGE_MODULES]) == []


def test_commands_import_nothing_heavy_when_they_are_loaded():
    """At module level a command may import typer, rich, and what is light of ours."""
    light = {
        "stages.interrupts",
        "artifacts.errors",
        "stages.configs",
        "stages.presets",
        "stages.reproduction.plan",
        "ifo_cli",
        "typer",
        "rich",
    }
    for path in files("ifo_cli"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = [node.module or ""] if isinstance(node, ast.ImportFrom) else [n.name for n in node.names]
                for name in names:
                    ours = name.partition(".")[0] in (
                        "artifacts",
                        "stages",
                        "torch",
                        "numpy",
                        "mujoco",
                        "pydantic",
                    )
                    assert not ours or name in light, f"{path.name} imports {name} when it is loaded"
