"""Blocks that Ctrl-C and `kill` do not interrupt in the middle."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

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
