"""Chooses the GL backend before any test imports mujoco; skips what draws where there is none, or needs a GPU."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from stages.simulation.gl import choose_backend

# Before torch is imported, here and in the processes that tests start: small work is fastest on one thread, and
# spinning threads would wait for each other on a busy machine.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

# Behind `&` shells have Ctrl-C ignored, which would go on to the processes that tests start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

BACKEND = choose_backend(required=False)


def pytest_collection_modifyitems(items):
    drawing, on_gpu = ([item for item in items if item.get_closest_marker(name)] for name in ("gl", "cuda"))
    if not BACKEND:
        for item in drawing:
            item.add_marker(pytest.mark.skip(reason="no OpenGL backend works here"))
    if on_gpu and not _torch_sees_gpu():
        for item in on_gpu:
            item.add_marker(pytest.mark.skip(reason="torch sees no GPU here"))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup():
    # A stage that ran in this process leaves torch with a thread per core. Where each core has a test process, small
    # operations on several threads take up to 80 times as long as on one.
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(1)


def _torch_sees_gpu() -> bool:
    import torch

    return torch.cuda.is_available()
