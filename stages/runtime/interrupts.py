"""Ctrl-C and kill, where libraries swallow them."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def heeded(at_once: bool = False) -> Iterator[Callable[[], None]]:
    """Note Ctrl-C and kill while the block runs; yields a function that raises KeyboardInterrupt once one has come.

    Python raises it wherever it happens to be. In a callback from C, of which h5py makes many, it is printed and
    forgotten, and the work goes on.

    Args:
        at_once: Raise it there, too: for work that takes long between two calls of the function.
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
    # What is ignored, as Ctrl-C is by work in the background, stays so.
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


@contextmanager
def killable() -> Iterator[None]:
    """`kill` ends the block as Ctrl-C does: what was half written is removed, and the message says how to go on."""
    before = signal.getsignal(signal.SIGTERM)
    if threading.current_thread() is not threading.main_thread() or before != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
