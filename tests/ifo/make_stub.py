"""`python -m tests.ifo.make_stub` writes ifo/pipeline.pyi: the types of the options of every stage."""

from __future__ import annotations

import ast
import dataclasses
import inspect
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from ifo import pipeline
from stages.config.commands import COMMANDS

STUB = Path(pipeline.__file__).with_suffix(".pyi")
HEADER = '''"""Written by `python -m tests.ifo.make_stub`: the stages of the pipeline, with the types of all options."""

from collections.abc import Sequence
from os import PathLike
from typing import Literal

from stages.runtime.run import StageResult as StageResult

AnyPath = str | PathLike[str]
'''


def type_of(kind: Any, choices: tuple[str, ...]) -> str:
    """How an option's type is written in the stub; None: the default."""
    literal = f"Literal[{', '.join(map(repr, choices))}]" if choices else "str"
    if get_origin(kind) is tuple:
        return f"Sequence[{literal}] | None"
    kinds = [each for each in get_args(kind) or (kind,) if each is not type(None)]
    [single] = kinds
    name = {str: literal, Path: "AnyPath"}.get(single, single.__name__)
    return f"{name} | None"


def stub() -> str:
    """The text of ifo/pipeline.pyi."""
    parts = [HEADER]
    for function in pipeline.STAGES:
        name = function.__name__.replace("_", "-")
        command = COMMANDS[name]
        known = pipeline.parameters(pipeline.command_of(name))
        types: dict[str, str] = {}
        for config in (command.shared, command.config):
            hints = get_type_hints(config)
            for item in dataclasses.fields(config):
                types[item.name] = type_of(hints[item.name], tuple(item.metadata["choices"]))
        [first] = [
            parameter for parameter in inspect.signature(function).parameters.values() if parameter.name != "options"
        ]
        kind = {"task": "str"}.get(first.name) or (
            "AnyPath | Sequence[AnyPath]" if "Sequence" in str(first.annotation) else "AnyPath"
        )
        options = "".join(f"    {option}: {types[option]} = None,\n" for option in known)
        parts.append(f"def {function.__name__}(\n    {first.name}: {kind},\n    *,\n{options}) -> StageResult: ...\n")
    text = "\n".join(parts)
    ast.parse(text)
    return text


if __name__ == "__main__":
    STUB.write_text(stub(), encoding="utf-8")
