"""Handling of Ctrl-C and `kill` where libraries would suppress them."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from artifacts.errors import IfoError

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def deferred_interrupts(at_once: bool = False) -> Iterator[Callable[[], None]]:
    """Record Ctrl-C and `kill` during the block; yield a function that raises KeyboardInterrupt after such a signal.

    By default Python raises KeyboardInterrupt at the current position. In a callback from C, which h5py uses often, the
    exception is printed and dropped, and the work continues.

    Args:
        at_once: Also raise the exception at the current position, for work with long times between calls of the
            function.
    """
    came: list[int] = []

    def check() -> None:
        if came:
            raise KeyboardInterrupt

    def note(number: int, _: Any) -> None:
        again = bool(came)
        came.append(number)
        if at_once or again:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield check
        return
    # Ignored signals stay ignored: background jobs, for example, ignore Ctrl-C.
    before = {number: signal.getsignal(number) for number in SIGNALS}
    heard = {number: handler for number, handler in before.items() if handler not in (signal.SIG_IGN, None)}
    try:
        for number in heard:
            signal.signal(number, note)
        yield check
        check()
    finally:
        for number, handler in heard.items():
            signal.signal(number, handler)


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
