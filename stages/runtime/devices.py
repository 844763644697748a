"""Choice of the device and of the number of threads and processes."""

from __future__ import annotations

from artifacts.errors import PlatformError, UsageError
from stages.config.common import check_device

MAX_WORKERS_A_CORE = 4
# The functions that torch computes by MKL's vector library.
MKL_FUNCTIONS = (
    *("acos", "asin", "atan", "cos", "erf", "erfc", "erfinv", "exp", "expm1", "log", "log10", "log1p", "log2"),
    *("sin", "sqrt", "tan", "tanh", "trunc"),
)


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
    """Let torch use `workers` threads, and return `workers`. Results do not vary from process to process."""
    import torch

    _choose_kernels()
    torch.set_num_threads(workers)
    return workers


def _choose_kernels() -> None:
    """Call each function of MKL's vector library once, on one thread.

    MKL chooses the kernel of a function when it is first called. In MKL before 2025, which torch contains, a second
    thread that calls it at the same time may be given a kernel of low accuracy (errors up to 3e-4) for that call
    (pytorch/pytorch#188792; results/LOG.md, "Two runs that differed").
    """
    import torch

    for dtype in (torch.float32, torch.float64):
        one = torch.full((1,), 0.5, dtype=dtype)
        for name in MKL_FUNCTIONS:
            getattr(torch, name)(one)
