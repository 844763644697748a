"""Choice of the device and of the number of threads and processes."""

from __future__ import annotations

from artifacts.errors import PlatformError, UsageError
from stages.config.common import check_device

MAX_WORKERS_A_CORE = 4


def pick_device(device: str) -> str:
    """Return the torch device to use; `auto` selects CUDA if it is available.

    Raises:
        PlatformError: The requested device is not available.
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
        raise PlatformError(f"--device {device}: torch finds no such CUDA device; use --device cpu")
    return device


def pick_workers(workers: int) -> int:
    """Return the number of threads and render processes to use.

    Raises:
        UsageError: The requested number is much larger than the number of cores.
    """
    import os

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if workers > MAX_WORKERS_A_CORE * cores:
        raise UsageError(f"--workers {workers}: expected at most {MAX_WORKERS_A_CORE * cores} on {cores} cores")
    return workers or cores


def use_threads(workers: int) -> int:
    """Let torch use `workers` threads, and return `workers`."""
    import torch

    torch.set_num_threads(workers)
    return workers
