"""Handling of Ctrl-C and `kill` in commands, also where libraries turn them into other errors."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from artifacts.errors import IfoError

_came: list[int] = []  # signals since `killable` began


@contextmanager
def killable() -> Iterator[None]:
    """Let `kill` end the block as Ctrl-C does: partial files are removed, and the message says how to continue."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.getsignal(number) for number in usual}
    try:
        for number, handler in before.items():
            if handler == usual[number]:
                signal.signal(number, _interrupt)
        yield
    finally:
        for number, handler in before.items():
            if handler == usual[number]:
                signal.signal(number, handler)
                _came.clear()


def _interrupt(number: int, _: Any) -> None:
    _came.append(number)
    raise KeyboardInterrupt


@contextmanager
def undisguised_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt again if a library turned it into an exception of its own, as ctypes does.

    Errors that a user can fix stay as they are.
    """
    try:
        yield
    except IfoError:
        raise
    except Exception as error:
        if _came:
            raise KeyboardInterrupt from error
        raise
