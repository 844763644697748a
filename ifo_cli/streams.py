"""Standard input and output: commands read paths from standard input and write exactly one line to standard output."""

from __future__ import annotations

import io
import json
import math
import os
import select
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any, TextIO

from artifacts.errors import ArtifactError, PlatformError, UsageError
from stages.runtime.terminal import one_line

MOST_BYTES = 1 << 20  # of paths on standard input; anything larger is not a list of paths
LONGEST_PATH = 4096  # bytes: PATH_MAX of Linux


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
    unread = f"name {what} as an argument instead"
    try:
        data = sys.stdin.buffer.read(MOST_BYTES)
    except OSError as error:
        raise ArtifactError(f"standard input cannot be read ({error.strerror}): {unread}") from error
    if b"\0" in data or len(data) == MOST_BYTES:
        raise ArtifactError(f"standard input is not an artifact path: {unread}")
    # Only at line feeds: names may contain other characters at which `splitlines` would split.
    lines = [line.strip() for line in os.fsdecode(data).split("\n") if line.strip()]
    if not lines:
        raise ArtifactError(
            "no artifact path on standard input: the previous stage failed; otherwise, name the file as an argument"
        )
    if len(lines) > 1 and not several:
        raise UsageError(f"{len(lines)} lines on standard input: expected one path, that of {what}")
    paths = [_path_of(line) for line in lines]
    if not all(map(_is_path, paths)):
        raise ArtifactError(f"standard input is not an artifact path: {unread}")
    return [Path(path) for path in paths]


def _is_path(text: str) -> bool:
    """Whether the file system can have this path."""
    try:
        return 0 < len(os.fsencode(text)) < LONGEST_PATH and "\0" not in text
    except UnicodeEncodeError:  # a surrogate, from JSON
        return False


def _path_of(line: str) -> str:
    """Return the path in a line that a stage printed, with or without --json."""
    if line.startswith("{"):
        with suppress(ValueError, KeyError, TypeError, RecursionError):
            return str(json.loads(line)["path"])
    return line


def emit(text: str) -> None:
    """Print text to standard output; in each of its lines, what is not printable is escaped."""
    print("\n".join(map(one_line, text.split("\n"))), flush=True)


def emit_path(path: Path) -> None:
    """Print a path so that the next stage reads the same path, whatever bytes are in its name."""
    line = str(path)
    if "\n" in line or _path_of(line.strip()) != line:
        line = json.dumps({"path": line})
    sys.stdout.flush()
    if binary := getattr(sys.stdout, "buffer", None):
        binary.write(os.fsencode(line) + b"\n")
    else:  # A caller of `main` has put a text stream in its place.
        print(line)
    sys.stdout.flush()


class _Output(io.FileIO):
    """Standard output. It is not an error if its reader has exited.

    Raises:
        PlatformError: It cannot be written. This is raised once: what follows is discarded.
    """

    def write(self, data: Any) -> int:
        try:
            return _written(super().write, data, self)
        except OSError as error:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self.fileno())
            os.close(null)
            if isinstance(error, BrokenPipeError):
                return len(data)
            raise PlatformError(
                f"standard output cannot be written ({error.strerror}): redirect it to another file"
            ) from error


class _Errors(io.FileIO):
    """Standard error. What cannot be written is lost: the work continues if nobody reads it."""

    def write(self, data: Any) -> int:
        try:
            return _written(super().write, data, self)
        except OSError:
            return len(data)


def _written(write: Callable[[Any], int | None], data: Any, stream: io.FileIO) -> int:
    """Write data, and return how many bytes were written; waits where the stream does not block."""
    while (count := write(data)) is None:
        select.select([], [stream], [])
    return count


@contextmanager
def standard_streams() -> Iterator[None]:
    """Provide standard streams that can be written to in the block, whatever this process was started with.

    Streams that are closed (as for daemons, or by `2>&-`) become the null device: otherwise, the next file to be opened
    gets their descriptor, and what a library prints ends up in it. Text that the encoding of a stream does not have is
    escaped. Streams that were already replaced in Python stay.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor, which is this one
    usual = sys.stdout, sys.stderr
    if sys.stdout is sys.__stdout__:
        sys.stdout = _text(_Output(1, "w", closefd=False), usual[0])
    if sys.stderr is sys.__stderr__:
        sys.stderr = _text(_Errors(2, "w", closefd=False), usual[1])
    try:
        yield
    finally:
        with suppress(PlatformError):
            sys.stdout.flush()
        sys.stdout, sys.stderr = usual


def _text(raw: io.FileIO, usual: TextIO | None) -> io.TextIOWrapper:
    encoding = "utf-8" if usual is None else usual.encoding
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=encoding,
        errors="backslashreplace",
        line_buffering=raw.isatty() or raw.fileno() == 2,
    )


@contextmanager
def stdout_to_stderr() -> Iterator[None]:
    """Redirect to standard error what libraries and child processes print while the block runs."""
    sys.stdout.flush()
    kept = os.dup(1)
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
