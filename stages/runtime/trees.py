"""Conversion of torch state dicts to trees of NumPy arrays and plain numbers, as stored in checkpoints, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch


def to_tree(value: Any) -> Any:
    """Replace every tensor in nested dicts, lists and tuples by a NumPy copy."""
    if isinstance(value, torch.Tensor):
        return value.detach().cpu().numpy().copy()
    if isinstance(value, dict):
        return {key: to_tree(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(to_tree(item) for item in value)
    return value


def check_optimiser(optimiser: torch.optim.Optimizer) -> None:
    """Check a restored optimizer, whose state torch takes over without a look at its shapes.

    Raises:
        ValueError: The state does not fit the parameters.
    """
    for parameter, state in optimiser.state.items():
        for name, value in state.items():
            shape = () if name == "step" else parameter.shape
            if isinstance(value, torch.Tensor) and (value.shape != shape or not value.is_floating_point()):
                raise ValueError(f"{name} of the optimizer is {value.dtype} of shape {tuple(value.shape)}")


def from_tree(value: Any) -> Any:
    """Replace every NumPy array in nested dicts, lists and tuples by a tensor."""
    if isinstance(value, np.ndarray):
        return torch.from_numpy(np.array(value, value.dtype.newbyteorder("=")))
    if isinstance(value, dict):
        return {key: from_tree(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(from_tree(item) for item in value)
    return value
