"""Every command and option that a page names exists, and every command line is one that its program accepts."""

from __future__ import annotations

import importlib.util
import re
import shlex
import tomllib

import pytest
import typer.main

from ifo_cli.main import app
from tests.docs.pages import PAGES, ROOT, SPAN, commands, lines, name, prose

GROUP = typer.main.get_command(app)
OPTIONS = {
    command: {option for parameter in known.params for option in (*parameter.opts, *parameter.secondary_opts)}
    for command, known in GROUP.commands.items()
}
OWN = {"--version", "--help", "-h", "--install-completion", "--show-completion"}  # of `ifo` itself
OTHERS = {"--no_python", "--no-python", "--nproc_per_node"}  # of launchers
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
LINES = [pytest.param(line, id=f"{name(page)}: {line[:60]}") for page in PAGES for line in lines(page)]


def check_ifo(words):
    command, *arguments = words
    if command in OWN:
        return
    assert command in GROUP.commands, f"no command {command}"
    GROUP.commands[command].make_context(command, arguments)


def check_make(words):
    for word in words:
        variable, assigned, _ = word.partition("=")
        known = rf"^{variable} \?=|\$\({variable}\)" if assigned else rf"^{re.escape(word)}:"
        assert re.search(known, MAKEFILE, re.M), f"make {word}"


def check_python(words):
    if words[0] == "-m":
        assert importlib.util.find_spec(words[1]), words[1]
    else:
        assert (ROOT / words[0]).is_file(), words[0]


def check_pip(words):
    assert words[0] == "install"
    for word in words[1:]:
        for extra in re.findall(r"\w+", (re.findall(r"^(?:\.|ifo)\[(.*)\]$", word) or [""])[0]):
            assert extra in EXTRAS, word


def check_launched(program, words):
    """A launcher of several processes: its own parser takes its options, ours those of ifo."""
    if program == "torchrun":
        from torch.distributed.run import get_args_parser

        parser = get_args_parser()
        found = parser.parse_args(words)
    else:
        launch = pytest.importorskip("accelerate.commands.launch")
        assert words.pop(0) == "launch"
        found = launch.launch_command_parser().parse_args(words)
    assert found.training_script == "ifo"
    check_ifo(found.training_script_args)


@pytest.mark.parametrize("line", LINES)
def test_a_command_line_is_accepted(line):
    for program, *words in commands(line):
        match program:
            case "ifo":
                check_ifo(words)
            case "make":
                check_make(words)
            case "python" | ".venv/bin/python":
                check_python(words)
            case "pip" | ".venv/bin/pip":
                check_pip(words)
            case "accelerate" | "torchrun":
                check_launched(program, words)
            case "tensorboard":
                assert words == ["--logdir", "runs"]
            case "export":
                assert all(re.fullmatch(r"[A-Z_]+=\S+", word) for word in words)
            case _:
                pytest.fail(f"what is {program}? Tell this test how to check it")


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_commands_and_options_in_the_text_exist(page):
    every = set().union(*OPTIONS.values(), OWN, OTHERS)
    for span in SPAN.findall(prose(page)):
        words = re.split(r"\s+", span.removeprefix("ifo "))
        command = words[0]
        if span.startswith("ifo ") and not command.startswith("-") and not command.isupper():
            assert command in OPTIONS, span
        known = OPTIONS.get(command, every) | OWN
        if span.startswith(("ifo ", "--")) or command in OPTIONS:
            for option in re.findall(r"(?<![\w-])(--?[a-z][\w-]*)(?=[\s=,)]|$)", span.partition(" | ")[0]):
                assert option in known, f"{span}: {option}"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_make_targets_in_the_text_exist(page):
    for span in SPAN.findall(prose(page)):
        if span.startswith("make "):
            check_make(shlex.split(span)[1:])


def test_the_readme_lists_every_extra():
    rows = re.findall(r"^\| (`[^|]*`) \|", (ROOT / "README.md").read_text(encoding="utf-8"), re.M)
    listed = {extra for row in rows for extra in re.findall(r"`([a-z]+)`", row)}
    assert set(EXTRAS) <= listed
