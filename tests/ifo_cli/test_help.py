"""`ifo --help` answers at once, and every command explains itself."""

from __future__ import annotations

import dataclasses
import importlib
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from ifo_cli.main import app
from stages.config.presets import PRESETS
from stages.config.stages import STAGES

ROOT = Path(__file__).parents[2]
COMMANDS = [command.name for command in app.registered_commands]
OF_LIBRARY = 2.5  # times the processor time of importing typer with its formatting
SECONDS = 0.4


@pytest.fixture
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("TERMINAL_WIDTH", "200")


def test_every_stage_has_a_command():
    assert set(STAGES) <= set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(run_ifo, command):
    code, out, err = run_ifo(command, "--help")
    assert (code, err) == (0, "")
    assert re.search(rf"Examples?:\s+ifo .*\b{command}\b", out, re.S)


@pytest.mark.parametrize("stage", STAGES)
def test_help_lists_every_field_and_the_preset(run_ifo, wide, stage):
    _, out, _ = run_ifo(stage, "--help")
    for field in dataclasses.fields(STAGES[stage]):
        assert f"--{field.name.replace('_', '-')}" in out
    assert "--preset" in out and "those of preset quick" in out


def test_help_shows_the_quick_default_and_the_bound(run_ifo, wide):
    _, out, _ = run_ifo("collect-demos", "--help")
    line = next(line for line in out.splitlines() if "--n " in line)
    assert f"({PRESETS['quick']['collect-demos'].n})" in line and "x>=2" in line


@pytest.mark.parametrize("stage", STAGES)
def test_resume_is_offered_where_there_are_checkpoints(run_ifo, wide, stage):
    _, out, _ = run_ifo(stage, "--help")
    assert ("--resume" in out) == (stage in ("train-expert", "train-translator", "learn-policy"))


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_shows_names_as_they_are_typed(run_ifo, wide, command):
    """Rich replaces `:ID:` and the like by an emoji."""
    _, out, _ = run_ifo(*filter(None, [command]), "--help")
    assert [letter for letter in out if ord(letter) >= 0x1F000] == []


def test_paragraphs_of_the_help_fill_the_width(run_ifo, wide):
    _, out, _ = run_ifo("collect-demos", "--help")
    assert "Only frames are recorded for learning: no actions and no states." in out


def processor_time(*words):
    """The least of five runs of Python, in seconds: a busy machine changes it less than the time that passes."""

    def seconds():
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *words], check=True, capture_output=True, cwd=ROOT)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    return min(seconds() for _ in range(5))


def test_help_is_quick():
    """On a slow machine, in proportion to the library that prints it."""
    library = processor_time("-c", "import typer.rich_utils")
    assert processor_time("-m", "ifo_cli.main", "--help") < max(SECONDS, OF_LIBRARY * library)


def test_help_loads_nothing_heavy():
    code = (
        "import sys; from ifo_cli.main import main; main(['--help']);"
        "print([m for m in ('torch', 'mujoco', 'numpy', 'pydantic', 'h5py') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.splitlines()[-1] == "[]"


def test_version(run_ifo):
    code, out, _ = run_ifo("--version")
    assert code == 0 and re.fullmatch(r"ifo \S+\n", out)


def test_nothing_at_all_shows_the_help(run_ifo):
    code, out, err = run_ifo()
    assert code == 2 and "train-translator" in out + err


def test_completion_script_is_offered():
    command = [sys.executable, "-c", "from ifo_cli.main import main; main()"]
    environment = {"_IFO_COMPLETE": "source_bash", "PATH": "/usr/bin:/bin"}
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert "_IFO_COMPLETE" in done.stdout


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("ifo col", "collect-demos"),
        ("ifo collect-demos re", "reach"),
        ("ifo reproduce --only st", "strike"),
        ("ifo reproduce --only reach,st", "reach,strike"),
        ("ifo reproduce --methods oracle,gail,gail", "oracle,gail,gail-own"),  # gail is in the list already
    ],
)
def test_completion_completes(line, expected):
    environment = {
        "_IFO_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split()) - 1),
        "PATH": "/usr/bin:/bin",
    }
    command = [sys.executable, "-c", "from ifo_cli.main import main; main()"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert done.stdout.split() == [expected]


def test_the_documentation_lists_the_commands():
    text = (ROOT / "docs/reference/commands.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `ifo ([a-z-]+)", text, re.M)
    assert listed == COMMANDS


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_examples_can_be_copied_at_80_columns(run_ifo, monkeypatch, command):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERMINAL_WIDTH", "80")
    _, out, _ = run_ifo(*filter(None, [command]), "--help")
    shown = re.split(r"Examples?:\s*\n", out)[-1]
    lines = " ".join(line.strip() for line in shown.splitlines()).replace(" \\ ", " ").strip()
    module = importlib.import_module(f"ifo_cli.{command.replace('-', '_') or 'main'}")
    assert lines == " ".join(module.EXAMPLES if command else (module.PIPELINE,))
    assert all(line.strip().startswith("ifo ") for line in re.sub(r"\\\s*\n", "", shown).splitlines() if line.strip())
