"""Ctrl-C that a library suppressed still takes effect."""

from __future__ import annotations

import ctypes
import os
import signal

import pytest

from artifacts import ArtifactError
from stages.runtime.interrupts import deferred_interrupts, killable, undisguised_interrupts


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


def test_a_kill_counts_as_ctrl_c_for_as_long_as_the_block_runs():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), killable():
        os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) == before


class Interrupting:
    """An argument of a C function. Ctrl-C arrives while ctypes converts it, as it may in every call of OpenGL."""

    @classmethod
    def from_param(cls, value):
        os.kill(os.getpid(), signal.SIGINT)
        return value


def test_an_interrupt_that_a_library_turned_into_another_error_is_an_interrupt_again():
    function = ctypes.CDLL(None).abs
    function.argtypes = [Interrupting]
    with killable(), pytest.raises(ctypes.ArgumentError):
        function(1)
    with pytest.raises(KeyboardInterrupt), killable(), undisguised_interrupts():
        function(1)


@pytest.mark.parametrize("error", [ValueError("no signal came"), ArtifactError("x.h5: is damaged")])
def test_other_errors_stay_as_they_are(error):
    with pytest.raises(type(error), match=str(error)), killable(), undisguised_interrupts():
        if isinstance(error, ArtifactError):
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
        raise error
