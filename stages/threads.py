"""How many threads the numeric libraries use."""

from __future__ import annotations


def use_threads(workers: int) -> int:
    """Let torch use `workers` threads; returns `workers`."""
    import torch

    torch.set_num_threads(workers)
    return workers
