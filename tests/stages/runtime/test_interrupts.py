"""`kill` counts as Ctrl-C, and an interrupt that a library turned into another error is one again."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time

import pytest

from artifacts import ArtifactError
from stages.runtime.interrupts import killable, undisguised_interrupts


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


class Dying:
    """Ctrl-C arrives in its destructor, as it may in those of any library."""

    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)


def test_an_interrupt_in_a_destructor_is_not_lost_and_shows_no_traceback(capfd):
    hook = sys.unraisablehook
    with pytest.raises(KeyboardInterrupt), killable():
        Dying()
        reached = time.monotonic()
        while time.monotonic() < reached + 10:
            pass
    assert time.monotonic() < reached + 5 and sys.unraisablehook is hook
    assert capfd.readouterr().err == ""


def test_an_interrupt_that_comes_too_late_to_come_again_does_nothing():
    with killable():
        Dying()
    time.sleep(0.2)


@pytest.mark.parametrize("error", [ValueError("no signal came"), ArtifactError("x.h5: is damaged")])
def test_other_errors_stay_as_they_are(error):
    with pytest.raises(type(error), match=str(error)), killable(), undisguised_interrupts():
        if isinstance(error, ArtifactError):
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
        raise error
