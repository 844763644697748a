"""Which device, and how many threads and processes, a stage uses."""

from __future__ import annotations

from artifacts.errors import PlatformError, UsageError
from stages.config.common import check_device

MAX_WORKERS_A_CORE = 4


def pick_device(device: str) -> str:
    """The torch device to use; `auto` is CUDA where there is one.

    Raises:
        PlatformError: The device asked for is not there.
        UsageError: There is no such kind of device.
    """
    import torch

    check_device(device)
    if device == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cpu":
        return device
    index = int(device.partition(":")[2] or 0)
    if not torch.cuda.is_available() or index >= torch.cuda.device_count():
        raise PlatformError(f"--device {device}: torch sees no such CUDA device here; use --device cpu")
    return device


def pick_workers(workers: int) -> int:
    """Threads and render processes to use.

    Raises:
        UsageError: Far more than there are cores.
    """
    import os

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if workers > MAX_WORKERS_A_CORE * cores:
        raise UsageError(f"--workers {workers}: expected at most {MAX_WORKERS_A_CORE * cores} on {cores} cores")
    return workers or cores


def use_threads(workers: int) -> int:
    """Let torch use `workers` threads; returns `workers`."""
    import torch

    torch.set_num_threads(workers)
    return workers
