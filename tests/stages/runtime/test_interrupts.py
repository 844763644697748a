"""`kill` counts as Ctrl-C, and an interrupt that a library turned into another error is one again."""

from __future__ import annotations

import ctypes
import os
import signal

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


@pytest.mark.parametrize("error", [ValueError("no signal came"), ArtifactError("x.h5: is damaged")])
def test_other_errors_stay_as_they_are(error):
    with pytest.raises(type(error), match=str(error)), killable(), undisguised_interrupts():
        if isinstance(error, ArtifactError):
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
        raise error
