"""Standard input and output: commands read paths from standard input and write exactly one line to standard output."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any

from artifacts.errors import ArtifactError, UsageError

MOST_BYTES = 1 << 20  # of paths on standard input; anything larger is not a list of paths


def inputs_or_stdin(named: Sequence[Path], what: str, *, several: bool = False) -> list[Path]:
    """Return the paths named on the command line, or else those on standard input.

    Raises:
        UsageError: There is no argument and no pipe, or more paths than the command accepts.
        ArtifactError: The pipe is empty or does not hold a list of paths.
    """
    if named:
        return list(named)
    if sys.stdin is None or sys.stdin.isatty():
        raise UsageError(f"no input: name {what}, or pipe in the command that writes it")
    data = sys.stdin.buffer.read(MOST_BYTES)
    if b"\0" in data or len(data) == MOST_BYTES:
        raise ArtifactError(f"standard input is not an artifact path: name {what} as an argument instead")
    lines = [line.strip() for line in os.fsdecode(data).splitlines() if line.strip()]
    if not lines:
        raise ArtifactError(
            "no artifact path on standard input: the previous stage failed; otherwise, name the file as an argument"
        )
    if len(lines) > 1 and not several:
        raise UsageError(f"{len(lines)} lines on standard input: expected one path, that of {what}")
    return [Path(_path_of(line)) for line in lines]


def _path_of(line: str) -> str:
    """Return the path in a line that a stage printed, with or without --json."""
    if line.startswith("{"):
        with suppress(ValueError, KeyError, TypeError):
            return str(json.loads(line)["path"])
    return line


def emit(text: str) -> None:
    """Print to standard output; it is not an error if the reader has exited."""
    if sys.stdout is None:
        return
    try:
        print(text, flush=True)
    except BrokenPipeError:
        abandon_stdout()


def abandon_stdout() -> None:
    """Redirect standard output to the null device after its pipe closed, so that the final flush does not fail."""
    with suppress(OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)


@contextmanager
def stdout_to_stderr() -> Iterator[None]:
    """Redirect to standard error what libraries and child processes print while the block runs."""
    if sys.stdout is None or sys.stderr is None:
        yield
        return
    sys.stdout.flush()
    try:
        kept = os.dup(1)
    except OSError:
        yield
        return
    try:
        os.dup2(2, 1)
        with redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def plain(value: Any) -> Any:
    """Return JSON-ready values: NumPy values become plain numbers and lists, paths text, non-finite numbers null."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)
