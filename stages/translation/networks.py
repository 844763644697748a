"""The context translator: Enc1, Enc2, T and Dec (Sec. IV), in three architectures.

`paper` is the paper's network for simulation, and `real` is its network for real images. `compact` is for CPUs: its
encoders share weights, T predicts changes of the context frame's features, and Dec predicts changes of its pixels.
Inside the networks, images are float tensors (B, 3, H, W) in [-1, 1].
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from artifacts import Artifact, ArtifactError
from stages.config.stages import ARCHITECTURES
from stages.runtime.trees import from_tree
from stages.translation.layers import (
    LEAK,
    ConvEncoder,
    DropoutLinear,
    SkipConvTranspose2d,
    conv_transpose,
    he_initialise,
    strided,
)

HEAD = "weights/dec_head.weight"  # dataset of a translator


@dataclass
class EncodedContext:
    """Output of Enc2 for P context frames o_0^j.

    Attributes:
        features: Features z_2 (P, D).
        skips: Activations (P, C, h, w) of each convolution, finest first.
        image: Context frames (P, 3, H, W).
        palette: Colors (P, C, 3) found in the frames, if the architecture uses them.
    """

    features: Tensor
    skips: list[Tensor]
    image: Tensor
    palette: Tensor | None = None


class Translator(nn.Module, ABC):
    """Base class of the translation network M(o_t^i, o_0^j) = Dec(T(Enc1(o_t^i), Enc2(o_0^j))).

    Attributes:
        feature_size: Width D of z_1, z_2 and z_3.
        plain: Whether to decode with plain concatenation of skips; for tests and benchmarks.
    """

    feature_size: int

    def __init__(self) -> None:
        super().__init__()
        self.plain = False

    @abstractmethod
    def encode(self, images: Tensor) -> Tensor:
        """Features z_1 = Enc1(o) of images: (B, 3, H, W) -> (B, D)."""

    @abstractmethod
    def encode_context(self, images: Tensor) -> EncodedContext:
        """Output of Enc2(o_0) for P context frames (P, 3, H, W)."""

    def encode_all(self, images: Tensor, contexts: Tensor) -> tuple[Tensor, EncodedContext]:
        """Features z_1 (B, D) of images and the output of Enc2 for context frames: `encode` and `encode_context`."""
        return self.encode(images), self.encode_context(contexts)

    @abstractmethod
    def translate(self, z1: Tensor, context: EncodedContext) -> Tensor:
        """Translated features z_3 = T(z_1, z_2), K frames per context: (P * K, D) -> (P * K, D)."""

    @abstractmethod
    def decode(self, features: Tensor, context: EncodedContext) -> Tensor:
        """Images (P * K, 3, H, W) that Dec makes from features (P * K, D) and their contexts."""

    def _upsample(self, layer: SkipConvTranspose2d, x: Tensor, skip: Tensor, size: tuple[int, int]) -> Tensor:
        forward = layer.forward_joined if self.plain else layer.forward_split
        return forward(x, skip, size)


class PaperTranslator(Translator):
    """The network for simulation (Sec. VI.A): four 5x5 stride-2 convolutions, two layers of 1024, untied encoders."""

    CHANNELS: tuple[int, ...] = (64, 128, 256, 512)
    STRIDES: tuple[int, ...] = (2, 2, 2, 2)
    FEATURES = 1024
    TIED = False  # Enc1 = Enc2
    DROPOUT = 0.0  # dropout probability of the inputs of every fully connected layer

    def __init__(self, size: tuple[int, int], feature_size: int | None = None):
        super().__init__()
        self.feature_size = width = feature_size or self.FEATURES
        self.sizes = strided(size, self.STRIDES)
        coarse = self.CHANNELS[-1] * self.sizes[-1][0] * self.sizes[-1][1]

        def dense(inputs: int, outputs: int) -> nn.Module:
            return DropoutLinear(inputs, outputs, self.DROPOUT)

        def head() -> nn.Module:
            return nn.Sequential(dense(coarse, width), nn.LeakyReLU(LEAK), dense(width, width), nn.LeakyReLU(LEAK))

        self.enc1, self.enc1_head = ConvEncoder(self.CHANNELS, self.STRIDES, 5), head()
        if not self.TIED:  # Otherwise Enc2 is Enc1, and its weights are stored only once.
            self.enc2, self.enc2_head = ConvEncoder(self.CHANNELS, self.STRIDES, 5), head()
        self.translation = nn.Sequential(dense(2 * width, width), nn.LeakyReLU(LEAK), dense(width, width))
        self.dec_head = dense(width, coarse)
        outputs = (*self.CHANNELS[-2::-1], 3)
        inputs = (self.CHANNELS[-1], *outputs[:-1])
        mirrored = zip(inputs, self.CHANNELS[::-1], outputs, self.STRIDES[::-1], strict=True)
        self.dec = nn.ModuleList(SkipConvTranspose2d(a, s, b, 5, stride) for a, s, b, stride in mirrored)
        he_initialise(self)

    @classmethod
    def coarse_grid(cls, size: tuple[int, int]) -> tuple[int, int, int]:
        """Channels, height and width of the last convolution's activations for frames of a height and width."""
        return cls.CHANNELS[-1], *strided(size, cls.STRIDES)[-1]

    @classmethod
    def head_shape(cls, size: tuple[int, int]) -> tuple[int, int]:
        """Shape of the weights of Dec's fully connected layer for frames of a height and width."""
        channels, height, width = cls.coarse_grid(size)
        return channels * height * width, cls.FEATURES

    def encode(self, images: Tensor) -> Tensor:
        return self.enc1_head(self.enc1(images)[-1].flatten(1))

    def encode_context(self, images: Tensor) -> EncodedContext:
        convolutions, head = (self.enc1, self.enc1_head) if self.TIED else (self.enc2, self.enc2_head)
        skips = convolutions(images)
        return EncodedContext(head(skips[-1].flatten(1)), skips, images)

    def translate(self, z1: Tensor, context: EncodedContext) -> Tensor:
        z2 = context.features.repeat_interleave(len(z1) // len(context.features), dim=0)
        return self.translation(torch.cat([z1, z2], dim=1))

    def decode(self, features: Tensor, context: EncodedContext) -> Tensor:
        x = F.leaky_relu(self.dec_head(features), LEAK).unflatten(1, (self.CHANNELS[-1], *self.sizes[-1]))
        for k, layer in enumerate(self.dec):
            x = self._upsample(cast(SkipConvTranspose2d, layer), x, context.skips[-1 - k], self.sizes[-2 - k])
            if k + 1 < len(self.dec):
                x = F.leaky_relu(x, LEAK)
        return x


class RealTranslator(PaperTranslator):
    """The network for real images (Sec. VI.A): narrow, with tied encoders and dropout, for about a hundred videos.

    It has convolutions of 32, 16, 16 and 8 filters with strides 1, 2, 1 and 2, and fully connected layers and features
    of width 100. Fractionally strided convolutions of 16, 16, 32 and 3 filters have strides 1/2, 1, 1/2 and 1; each
    also receives the Enc2 layer of the same size. Enc1 and Enc2 share weights. Every fully connected layer has dropout
    with probability 0.5.

    Details that the paper does not specify are the same as in the network for simulation: 5x5 kernels, two fully
    connected layers per encoder, and LeakyReLU except after the last layer of T and after the image. The fully
    connected layer of Dec is as wide as its output, 8 filters at a quarter of the frame size, because 100 values are
    too few for an image. Dropout applies to the inputs of fully connected layers, not to their outputs (the paper does
    not say which), so L_align and the reward compare complete features. Dropout is active only during training.
    """

    CHANNELS = (32, 16, 16, 8)
    STRIDES = (1, 2, 1, 2)
    FEATURES = 100
    TIED = True
    DROPOUT = 0.5


class CompactTranslator(Translator):
    """A small network for CPUs with tied encoders; all outputs are relative to the context frame.

    Enc1 = Enc2, so z_2 = Enc1(o_0^j), and T adds a change to z_2: z_3 = z_2 + T'(z_1, z_2), where T' = 0 before
    training. Feature tracking therefore starts with the features of the context frame and improves on them.

    Dec uses the colors of the context. Each pixel is a mixture of the context frame's pixel, a few colors that
    attention finds in the context frame (the palette), and a small correction. Features therefore have to encode only
    geometry, not colors.

    The first convolution has stride 4. At 48x48 pixels, the two finest resolutions would otherwise take most of the CPU
    time and contribute little.
    """

    def __init__(
        self,
        size: tuple[int, int],
        feature_size: int = 256,
        fine: int = 64,
        coarse: int = 128,
        hidden: int = 512,
        colours: int = 4,
    ):
        super().__init__()
        self.feature_size, self.size, self.colours = feature_size, size, colours
        self.fine_size = (size[0] // 4, size[1] // 4)
        self.coarse_shape = (coarse, (self.fine_size[0] + 1) // 2, (self.fine_size[1] + 1) // 2)
        flat = self.coarse_shape[0] * self.coarse_shape[1] * self.coarse_shape[2]
        self.fine = nn.Conv2d(3, fine, 6, stride=4, padding=1)
        self.coarse = nn.Conv2d(fine, coarse, 3, stride=2, padding=1)
        self.head = nn.Linear(flat, feature_size)
        change = nn.Linear(hidden, feature_size)
        self.translation = nn.Sequential(
            nn.Linear(2 * feature_size, hidden),
            nn.LeakyReLU(LEAK),
            nn.Linear(hidden, hidden),
            nn.LeakyReLU(LEAK),
            change,
        )
        self.palette_coarse = nn.ConvTranspose2d(coarse, fine, 4, stride=2, padding=1)
        self.palette_fine = nn.ConvTranspose2d(fine, colours, 8, stride=4, padding=2)
        self.palette_pixels = nn.Sequential(
            nn.Conv2d(3, 16, 3, padding=1), nn.LeakyReLU(LEAK), nn.Conv2d(16, colours, 1)
        )
        self.dec_head = nn.Linear(2 * feature_size, flat)
        self.dec_coarse = SkipConvTranspose2d(coarse, coarse, fine, 4)
        self.dec_fine = SkipConvTranspose2d(fine, fine, colours + 1 + 3, 8, stride=4)
        he_initialise(self)
        nn.init.zeros_(change.weight)
        nn.init.normal_(self.head.weight, std=flat**-0.5)
        with torch.no_grad():  # Dec initially returns nearly the context frame, with a small correction.
            self.dec_fine.weight.mul_(0.3)
            self.dec_fine.weight[:, colours + 1 :].mul_(0.1)
            cast(Tensor, self.dec_fine.bias)[0] = 2.0

    @classmethod
    def coarse_grid(cls, size: tuple[int, int]) -> tuple[int, int, int]:
        """Channels, height and width of the last convolution's activations for frames of a height and width."""
        return 128, (size[0] // 4 + 1) // 2, (size[1] // 4 + 1) // 2

    @classmethod
    def head_shape(cls, size: tuple[int, int]) -> tuple[int, int]:
        """Shape of the weights of Dec's fully connected layer for frames of a height and width."""
        channels, height, width = cls.coarse_grid(size)
        return channels * height * width, 2 * 256

    def _activations(self, images: Tensor) -> list[Tensor]:
        fine = F.leaky_relu(self.fine(images), LEAK)
        return [fine, F.leaky_relu(self.coarse(fine), LEAK)]

    def encode(self, images: Tensor) -> Tensor:
        return self.head(self._activations(images)[-1].flatten(1))

    def encode_context(self, images: Tensor) -> EncodedContext:
        skips = self._activations(images)
        return EncodedContext(self.head(skips[-1].flatten(1)), skips, images, self._palette(images, skips))

    def encode_all(self, images: Tensor, contexts: Tensor) -> tuple[Tensor, EncodedContext]:
        """See `Translator.encode_all`; Enc1 = Enc2 encodes all images at once, with one gradient."""
        activations = self._activations(torch.cat([contexts, images]))
        z2, z1 = self.head(activations[-1].flatten(1)).split([len(contexts), len(images)])
        skips = [layer[: len(contexts)] for layer in activations]
        return z1, EncodedContext(z2, skips, contexts, self._palette(contexts, skips))

    def _palette(self, images: Tensor, skips: list[Tensor]) -> Tensor:
        """Colors (P, C, 3) of context frames (P, 3, H, W): attention-weighted means over pixels."""
        height, width = self.fine_size
        coarse = self.palette_coarse(skips[1])[..., :height, :width]
        layer = self.palette_fine
        fine = conv_transpose(F.leaky_relu(coarse + skips[0], LEAK), layer.weight, layer.bias, 4, self.size)
        scores = self.palette_pixels(images) + fine
        attention = torch.softmax(2.0 * scores.flatten(2), dim=-1)
        return torch.einsum("pkx,pcx->pkc", attention, images.flatten(2))

    def translate(self, z1: Tensor, context: EncodedContext) -> Tensor:
        z2 = context.features.repeat_interleave(len(z1) // len(context.features), dim=0)
        return z2 + self.translation(torch.cat([z1, z2], dim=1))

    def decode(self, features: Tensor, context: EncodedContext) -> Tensor:
        pairs, frames = len(context.features), len(features) // len(context.features)
        z2 = context.features.repeat_interleave(frames, dim=0)
        x = F.leaky_relu(self.dec_head(torch.cat([features - z2, z2], dim=1)), LEAK).unflatten(1, self.coarse_shape)
        x = F.leaky_relu(self._upsample(self.dec_coarse, x, context.skips[1], self.fine_size), LEAK)
        x = self._upsample(self.dec_fine, x, context.skips[0], self.size).unflatten(0, (pairs, frames))
        # Slices would cost the backward pass an image of zeros each, and einsum copies of the shares.
        scores, correction = x.split([self.colours + 1, 3], dim=2)
        kept, shares = torch.softmax(scores, dim=2).split([1, self.colours], dim=2)
        palette = cast(Tensor, context.palette).transpose(1, 2)[:, None]  # (P, 1, 3, C)
        painted = (palette @ shares.flatten(3)).unflatten(3, self.size)
        return torch.addcmul(painted + correction, kept, context.image[:, None]).flatten(0, 1)


NETWORKS: dict[str, type[PaperTranslator] | type[CompactTranslator]] = {
    "compact": CompactTranslator,
    "paper": PaperTranslator,
    "real": RealTranslator,
}


def make_translator(arch: str, size: tuple[int, int]) -> Translator:
    """Make a newly initialized translator.

    Args:
        arch: Architecture, one of ARCHITECTURES.
        size: Height and width of the frames, in pixels.

    Raises:
        ArtifactError: Height or width is not a multiple of 4.
    """
    if size[0] % 4 or size[1] % 4:
        raise ArtifactError(f"frames of {size[1]}x{size[0]} pixels: expected width and height to be multiples of 4")
    return NETWORKS[arch](size)


def load_translator(artifact: Artifact, device: str = "cpu") -> Translator:
    """Load the network from a translator artifact, in evaluation mode.

    Raises:
        ArtifactError: The architecture is unknown, or the weights do not fit it.
    """
    arch, size = artifact.config["arch"], artifact.config["size"]
    if arch not in ARCHITECTURES:
        known = ", ".join(ARCHITECTURES)
        raise ArtifactError(f"{artifact.path}: unknown architecture {arch!r}, expected one of {known}")
    # The size decides how large the network is: the file must hold such a network before one is made.
    wanted, (found, _) = NETWORKS[arch].head_shape(tuple(size)), artifact.describe().get(HEAD, ((), None))
    if found != wanted:
        raise ArtifactError(
            f"{artifact.path}: the weights do not fit architecture {arch} for frames of {size[1]}x{size[0]} pixels "
            f"({HEAD} has shape {found}, expected {wanted})"
        )
    with torch.random.fork_rng(devices=[]):
        model = make_translator(arch, tuple(size))
    try:
        model.load_state_dict(from_tree(artifact.group("weights")))
    except (RuntimeError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise ArtifactError(f"{artifact.path}: the weights do not fit architecture {arch} ({reason})") from error
    return model.to(device).eval().requires_grad_(False)


def to_images(frames: Tensor) -> Tensor:
    """Convert uint8 frames (..., H, W, 3) to float images (..., 3, H, W) in [-1, 1]."""
    return frames.movedim(-1, -3).float().div_(127.5).sub_(1.0)


def to_frames(images: Tensor) -> Tensor:
    """Convert float images (..., 3, H, W) in [-1, 1] to uint8 frames (..., H, W, 3)."""
    return images.add(1.0).mul(127.5).round().clamp(0, 255).to(torch.uint8).movedim(-3, -1)
