"""`python -m tests.ifo.make_stub` writes ifo/pipeline.pyi: the types of the options of every stage."""

from __future__ import annotations

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
from typing import Literal, TypedDict, Unpack

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


def options_of(name: str) -> dict[str, str]:
    """The options of a stage, each with its type."""
    command = COMMANDS[name]
    types: dict[str, str] = {}
    for config in (command.shared, command.config):
        hints = get_type_hints(config)
        for item in dataclasses.fields(config):
            types[item.name] = type_of(hints[item.name], tuple(item.metadata["choices"]))
    return {option: types[option] for option in pipeline.parameters(pipeline.command_of(name))}


def dictionary(name: str, base: str, types: dict[str, str]) -> str:
    """A class of options."""
    body = "".join(f"    {option}: {kind}\n" for option, kind in types.items()) or "    pass\n"
    return f"class {name}({base}, total=False):\n{body}"


def stub() -> str:
    """The text of ifo/pipeline.pyi."""
    options = {function.__name__: options_of(function.__name__.replace("_", "-")) for function in pipeline.STAGES}
    first, *others = options.values()
    common = {name: kind for name, kind in first.items() if all(other.get(name) == kind for other in others)}
    parts = [HEADER, dictionary("CommonOptions", "TypedDict", common)]
    for function in pipeline.STAGES:
        name = "".join(word.title() for word in function.__name__.split("_")) + "Options"
        own = {option: kind for option, kind in options[function.__name__].items() if option not in common}
        parts.append(dictionary(name, "CommonOptions", own))
        [taken] = [each for each in inspect.signature(function).parameters.values() if each.name != "options"]
        several = "AnyPath | Sequence[AnyPath]" if "Sequence" in str(taken.annotation) else "AnyPath"
        kind = "str" if taken.name == "task" else several
        parts.append(f"def {function.__name__}({taken.name}: {kind}, **options: Unpack[{name}]) -> StageResult: ...\n")
    return "\n".join(parts)


if __name__ == "__main__":
    STUB.write_text(stub(), encoding="utf-8")
