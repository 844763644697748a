"""Imports go one way: ifo_cli -> stages -> artifacts, and in stages/ from the stages to what they share."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
STAGES = sorted(path.stem for path in (ROOT / "stages").glob("*.py") if path.stem != "__init__")
PARTS = sorted(path.parent.name for path in (ROOT / "stages").glob("*/__init__.py"))
LONGEST = 350  # lines of a file of the product


def files(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for folder in ("artifacts", "ifo", "stages", "ifo_cli") for path in files(folder)}


def only_for_types(node: ast.stmt) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def statements(node: ast.AST, typed: bool) -> Iterator[ast.Import | ast.ImportFrom]:
    """Import statements below a node, wherever they stand; with `typed`, those for type checkers, too."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif isinstance(child, ast.stmt) and only_for_types(child) and not typed:
            continue
        else:
            yield from statements(child, typed)


def imported(path: Path, typed: bool = True) -> set[str]:
    """Every module that a file imports, `from a import b` giving a and a.b."""
    found = set()
    for node in statements(ast.parse(path.read_text(encoding="utf-8")), typed):
        if isinstance(node, ast.Import):
            found.update(name.name for name in node.names)
        else:
            package = path.relative_to(ROOT).with_suffix("").parts[: -node.level] if node.level else ()
            module = ".".join([*package, *([node.module] if node.module else [])])
            found.add(module)
            found.update(f"{module}.{name.name}" for name in node.names)
    return found


def offenders(folder: str, forbidden: list[str]) -> list[str]:
    return [
        f"{path.relative_to(ROOT)} imports {module}"
        for path in files(folder)
        for module in sorted(imported(path))
        if any(module == name or module.startswith(f"{name}.") for name in forbidden)
    ]


def circle(graph: dict[str, set[str]]) -> list[str]:
    """A circle in a graph of names, or []."""
    done: set[str] = set()

    def visit(name: str, above: list[str]) -> list[str]:
        if name in above:
            return [*above[above.index(name) :], name]
        if name in done:
            return []
        for other in sorted(graph.get(name, ())):
            if found := visit(other, [*above, name]):
                return found
        done.add(name)
        return []

    for name in sorted(graph):
        if found := visit(name, []):
            return found
    return []


def test_the_top_of_stages_is_the_pipeline():
    from ifo_cli import main

    commands = {command.name.replace("-", "_") for command in main.app.registered_commands}
    assert set(STAGES) == commands - {"ls", "gc", "inspect", "verify", "doctor", "check_task"}


def test_there_is_something_to_look_at():
    assert len(PARTS) > 8
    for folder in ("artifacts", "ifo", "stages", "ifo_cli", *(f"stages/{part}" for part in PARTS)):
        assert len(files(folder)) > 1, folder


def test_artifacts_know_nothing_of_stages_or_commands():
    assert offenders("artifacts", ["stages", "ifo_cli", "ifo"]) == []


def test_stages_know_nothing_of_commands():
    assert offenders("stages", ["ifo_cli", "ifo"]) == []


def test_only_the_stages_of_the_public_api_know_of_commands_and_nobody_knows_of_it():
    """`ifo.train_translator` and the others are the commands, so that both do the same."""
    assert {offender.split()[0] for offender in offenders("ifo", ["ifo_cli"])} == {"ifo/pipeline.py"}
    assert offenders("ifo_cli", ["ifo"]) == []


@pytest.mark.parametrize("part", PARTS)
def test_parts_import_no_stage(part):
    assert offenders(f"stages/{part}", [f"stages.{module}" for module in STAGES]) == []


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_imports_another_only_to_run_it(stage):
    others = {f"stages.{other}": other for other in STAGES if other != stage}
    for node in statements(ast.parse((ROOT / f"stages/{stage}.py").read_text(encoding="utf-8")), typed=True):
        names = [node.module] if isinstance(node, ast.ImportFrom) else [name.name for name in node.names]
        for name in names:
            if name in others:
                assert [alias.name for alias in node.names] == [others[name]], ast.unparse(node)


def test_simulation_imports_only_what_a_run_needs():
    others = [f"stages.{part}" for part in PARTS if part not in ("simulation", "runtime", "config")]
    assert offenders("stages/simulation", others) == []


def test_learners_know_no_reward():
    concrete = [module for module in offenders("stages/learners", ["stages.rewards"])]
    assert concrete == []


def test_no_modules_import_each_other_in_a_circle():
    graph = {module: imported(path, typed=False) & MODULES.keys() - {module} for module, path in MODULES.items()}
    assert circle(graph) == []


def test_the_search_for_circles_finds_one():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]


@pytest.mark.parametrize("folder", ["artifacts", "ifo", "stages", "ifo_cli"])
def test_no_file_is_too_long_to_read(folder):
    long = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in files(folder)}
    assert {name: lines for name, lines in long.items() if lines > LONGEST} == {}


def test_commands_import_nothing_heavy_when_they_are_loaded():
    """At module level a command may import typer, rich, and what is light of ours, all of `stages.config` among it."""
    light = {
        "stages.runtime.interrupts",
        "stages.runtime.terminal",
        "artifacts.errors",
        "artifacts.pipeline",
        "stages.config.stages",
        "stages.config.presets",
        "stages.config.task_names",
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
                    assert not ours or name in light or name.startswith("stages.config."), (
                        f"{path.name} imports {name} when it is loaded"
                    )
