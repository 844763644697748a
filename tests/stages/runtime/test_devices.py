"""Threads of torch."""

import torch
from torch.utils._python_dispatch import TorchDispatchMode

from stages.runtime import devices
from stages.runtime.devices import use_threads


class _Recorded(TorchDispatchMode):
    """Records the name, data type, size and number of threads of each operation."""

    def __init__(self):
        super().__init__()
        self.calls = set()

    def __torch_dispatch__(self, function, types, arguments=(), options=None):
        if arguments and torch.is_tensor(arguments[0]):
            name = function.overloadpacket.__name__
            self.calls.add((name, arguments[0].dtype, arguments[0].numel()))
        return function(*arguments, **(options or {}))


def test_functions_of_mkl_are_called_once_before_several_threads_call_them(monkeypatch):
    # The race itself changed 1 to 9% of processes on a busy machine, too few for a test.
    before = torch.get_num_threads()
    monkeypatch.setattr(torch, "set_num_threads", lambda workers: calls_before.update(recorded.calls))
    calls_before: set = set()
    with _Recorded() as recorded:
        assert use_threads(2) == 2
    for dtype in (torch.float32, torch.float64):
        assert {(name, dtype, 1) for name in ("sqrt", "exp", "log", "sin", "cos", "tanh", "erf")} <= calls_before
    assert {name for name, *_ in calls_before} >= set(devices.MKL_FUNCTIONS)
    assert torch.get_num_threads() == before
