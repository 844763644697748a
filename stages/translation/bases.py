"""Translators to fine-tune: their weights, fitted to another frame size."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from artifacts import Artifact, ArtifactError
from stages.config.names import ARCHITECTURES
from stages.translation.networks import NETWORKS, load_translator

Grid = tuple[int, int, int]

# Weights that depend on the frame size, per position of the coarsest activations.
READS_GRID = ("head.weight", "enc1_head.0.weight", "enc2_head.0.weight")  # (F, C * h * w)
WRITES_GRID = ("dec_head.weight", "dec_head.bias")  # (C * h * w, ...)


def architecture(artifact: Artifact) -> str:
    """Return the architecture of a translator.

    Raises:
        ArtifactError: It is unknown.
    """
    arch = artifact.config.get("arch")
    if arch not in ARCHITECTURES:
        raise ArtifactError(
            f"{artifact.path}: unknown architecture {arch!r}, expected one of {', '.join(ARCHITECTURES)}"
        )
    return str(arch)


def base_weights(artifact: Artifact, size: tuple[int, int]) -> dict[str, Tensor]:
    """Return the weights of a translator for frames of a height and width.

    Convolutions are kept. Fully connected layers that read or write the grid of the coarsest activations are resampled
    from the grid of the file's frame size to that of `size`, such that constant activations give the same features.

    Raises:
        ArtifactError: The file does not hold a translator.
    """
    arch = architecture(artifact)
    weights = {name: value.detach().clone() for name, value in load_translator(artifact).state_dict().items()}
    height, width = artifact.config["size"]
    network = NETWORKS[arch]
    old, new = network.coarse_grid((height, width)), network.coarse_grid(size)
    if old == new:
        return weights
    return {name: _on_grid(name, value, old, new) for name, value in weights.items()}


def _on_grid(name: str, value: Tensor, old: Grid, new: Grid) -> Tensor:
    """Convert the weights of one layer from one grid (C, h, w) to another, if they depend on it.

    A layer that reads the grid behaves as if the new activations were resampled to the old grid first; a layer that
    writes it, as if its output were resampled to the new grid.
    """
    if name in READS_GRID:
        return torch.einsum("fchw,nhw->fcn", value.unflatten(1, old), _resampling(new, old)).flatten(1)
    if name in WRITES_GRID:
        positions = value.reshape(old[0], old[1] * old[2], -1)
        resampled = torch.einsum("cnd,nhw->chwd", positions, _resampling(old, new))
        return resampled.reshape(-1, *value.shape[1:])
    return value


def _resampling(source: Grid, target: Grid) -> Tensor:
    """Weight (h * w, h', w') of each position of a source grid at each position of a target grid; they sum to one."""
    one_hot = torch.eye(source[1] * source[2]).reshape(-1, 1, source[1], source[2])
    return F.interpolate(one_hot, target[1:], mode="bilinear", align_corners=False, antialias=True)[:, 0]


def described_base(artifact: Artifact) -> dict[str, Any]:
    """Return what a fine-tuned translator records about the translator that it started from."""
    return {name: artifact.config.get(name) for name in ("task", "steps", "demonstrations", "size")}
