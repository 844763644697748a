"""Ctrl-C that a library suppressed still takes effect."""

from __future__ import annotations

import os
import signal

import pytest

from artifacts.interrupts import deferred_interrupts


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_is_raised_at_the_next_check(number):
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), deferred_interrupts() as check:
        check()
        os.kill(os.getpid(), number)
        reached = True
        check()
    assert reached and signal.getsignal(number) == before


def test_it_is_raised_at_the_end_where_nothing_checks():
    with pytest.raises(KeyboardInterrupt), deferred_interrupts():
        os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.parametrize("at_once", [True, False])
def test_the_second_one_is_raised_at_once(at_once):
    reached = []
    with pytest.raises(KeyboardInterrupt), deferred_interrupts(at_once):
        os.kill(os.getpid(), signal.SIGINT)
        reached.append(1)
        os.kill(os.getpid(), signal.SIGINT)
        reached.append(2)
    assert reached == ([] if at_once else [1])


def test_what_is_ignored_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with deferred_interrupts() as check:
            os.kill(os.getpid(), signal.SIGINT)
            check()
    finally:
        signal.signal(signal.SIGINT, before)
