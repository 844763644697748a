"""Handling of Ctrl-C and `kill` in commands, also where libraries turn them into other errors."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from artifacts.errors import IfoError

AGAIN = 0.05  # seconds after which an interrupt that was dropped comes again
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
        with _repeated_interrupts():
            yield
    finally:
        for number, handler in before.items():
            if handler == usual[number]:
                signal.signal(number, handler)
                _came.clear()


@contextmanager
def _repeated_interrupts() -> Iterator[None]:
    """Let an interrupt come again if it came in a destructor or callback, where Python prints and drops exceptions."""
    usual, timers = sys.unraisablehook, list[threading.Timer]()

    def hook(unraisable: Any) -> None:
        if not (_came and isinstance(unraisable.exc_value, KeyboardInterrupt)):
            usual(unraisable)
            return
        timers.append(threading.Timer(AGAIN, os.kill, (os.getpid(), _came[-1])))
        timers[-1].daemon = True
        timers[-1].start()

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = usual
        for timer in timers:
            timer.cancel()
            timer.join()


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
