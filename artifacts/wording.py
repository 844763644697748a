"""Words that error messages share."""

from __future__ import annotations

from artifacts.schema import COMMANDS


def how_to_make(kinds: str | tuple[str, ...] | None, verb: str) -> str:
    """`pass the file that `ifo x` printed`, for the kinds wanted."""
    kinds = (kinds,) if isinstance(kinds, str) else kinds
    commands = [f"`{COMMANDS[kind]}`" for kind in kinds or () if kind in COMMANDS]
    if not commands:
        return "pass an artifact that ifo wrote"
    if verb == "make":
        return f"make it with {' or '.join(commands)}"
    return f"pass the file that {' or '.join(commands)} printed"


def a_(kind: str) -> str:
    article = "an" if str(kind)[:1] in "aeiou" else "a"
    return f"{article} {kind} artifact"


def either(kinds: tuple[str, ...]) -> str:
    return " or ".join(a_(kind).removesuffix(" artifact") for kind in kinds)
