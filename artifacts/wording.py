"""Common parts of error messages, and context managers that add the file's name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from artifacts.errors import ArtifactError, IfoError, PlatformError
from artifacts.pipeline import COMMANDS


def how_to_make(kinds: str | tuple[str, ...] | None, missing: bool = False) -> str:
    """Return an instruction for the wanted kinds: pass the file that `ifo x` printed; if it is `missing`, make it."""
    kinds = (kinds,) if isinstance(kinds, str) else kinds
    commands = [f"`{COMMANDS[kind]}`" for kind in kinds or () if kind in COMMANDS]
    if not commands:
        return "pass an artifact that ifo wrote"
    if missing:
        return f"make it with {' or '.join(commands)}"
    return f"pass the file that {' or '.join(commands)} printed"


def a_(kind: str) -> str:
    article = "an" if str(kind)[:1] in "aeiou" else "a"
    return f"{article} {kind} artifact"


def either(kinds: tuple[str, ...]) -> str:
    return " or ".join(a_(kind).removesuffix(" artifact") for kind in kinds)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put the file's name before the message of an error."""
    try:
        yield
    except (ArtifactError, PlatformError) as error:
        joint = " " if str(error).startswith(("is ", "was ", "has ", "needs ")) else ": "
        raise type(error)(f"{path}{joint}{error}") from error.__cause__


@contextmanager
def undamaged(problem: str) -> Iterator[None]:
    """Convert the exceptions that h5py raises for a damaged file to ArtifactError."""
    try:
        yield
    except IfoError:
        raise
    except MemoryError as error:
        raise PlatformError("needs more memory than is free: use a machine with more") from error
    except (OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError) as error:
        reason = " ".join(str(error).split())
        raise ArtifactError(f"{problem} ({reason}): restore the file or make it again") from error
