"""What fuzzing needs: a registry of targets, strategies for awkward values, and the verdict on an exception.

A target is a Hypothesis test. `make test` runs it on some examples; `make fuzz` drives it with atheris, which searches
for inputs that reach new lines of ifo.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from contextlib import contextmanager, redirect_stderr
from typing import Any, TypeVar

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from artifacts import IfoError
from ifo_cli.main import main
from stages.runtime.terminal import one_line

EXAMPLES = 25  # of a target in `make test`
TARGETS: dict[str, Callable[..., None]] = {}
Function = TypeVar("Function", bound=Callable[..., None])

ODD_TEXTS = (
    "", " ", "\0", "a\nb", "\r", "\x1b[31mred", "\u202e", "\u2028", "\ud800", "\ufeff", "\t", "../x", "/dev/zero", "~",
    ".", "..", "é" * 150, "x" * 300, "a" * 5000, "<script>alert(1)</script>", "=1+1", "{0.__class__}", "{video_key}",
    "%s%n", "nan", "inf", "1e999", "0x10", "-1", "9" * 5000, "true", "None", "[]", "{}", ",", '"', "'", "#", "=", "::",
)  # fmt: skip
ODD_NUMBERS = (
    0, 1, -1, 2, 3, 2**15, 2**31, 2**32, 2**53, 2**63 - 1, 2**63, 2**64, -(2**63), 10**30, 10**400, 0.5, -0.0, 1e-320,
    1e17, 1e308, float("nan"), float("inf"), float("-inf"),
)  # fmt: skip

texts = st.one_of(st.sampled_from(ODD_TEXTS), st.text(max_size=12))
numbers = st.one_of(st.sampled_from(ODD_NUMBERS), st.integers(), st.floats())
scalars = st.one_of(st.none(), st.booleans(), numbers, texts)
values = st.recursive(
    scalars,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(texts, inner, max_size=4)),
    max_leaves=12,
)


def target(title: str, /, **arguments: st.SearchStrategy[Any]) -> Callable[[Function], Function]:
    """Register a function as a target whose arguments are drawn from these strategies."""

    def register(function: Function) -> Function:
        checks = [HealthCheck.too_slow, HealthCheck.data_too_large]
        limits = settings(
            max_examples=EXAMPLES,
            deadline=None,
            database=None,
            suppress_health_check=checks,
            phases=(Phase.generate,),  # A smaller example is rarely worth the time that finding it takes.
            report_multiple_bugs=False,
        )
        TARGETS[title] = limits(given(**arguments)(function))
        return TARGETS[title]  # type: ignore[return-value]

    return register


def handled(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function; return its result, or the IfoError that it raised for a user. Any other exception is a fault."""
    try:
        return function(*arguments)
    except IfoError as error:
        message = one_line(str(error))
        assert message.strip() and message.encode("utf-8"), "an error without a message"
        return error


def run_ifo(*words: object, stdin: bytes = b"") -> tuple[int, str, str]:
    """Run a command in this process; return its exit code, standard output and standard error. A bug is a fault."""
    with standard_input(stdin), redirect_stderr(io.StringIO()) as stderr:
        stdout, sys.stdout = sys.stdout, io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="backslashreplace")
        try:
            code = main([str(word) for word in words])
            sys.stdout.flush()
            printed = sys.stdout.buffer.getvalue().decode("utf-8", "surrogateescape")  # type: ignore[attr-defined]
        finally:
            sys.stdout = stdout
    said = stderr.getvalue()
    assert code in (0, 2, 3, 4) and "Traceback" not in said, said
    assert not code or [line.startswith("ifo: ") for line in said.splitlines()][-1:] == [True], said
    return code, printed, said


@contextmanager
def standard_input(data: bytes) -> Any:
    """Provide bytes on standard input in the block."""
    usual, sys.stdin = sys.stdin, io.TextIOWrapper(io.BytesIO(data))
    try:
        yield
    finally:
        sys.stdin = usual
