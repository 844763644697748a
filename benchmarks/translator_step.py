"""One training step of the translator: the context's share computed once a pair, against once a frame.

Prints one JSON line. Both forms compute the same loss (a test holds the gradients equal to 1e-5). The plain form
encodes the context for every frame of a pair and convolves the concatenated skips for every frame, as the loss of
Sec. IV is written; the clip-wise form encodes it once a pair and convolves the skips' half once a pair.
"""

from __future__ import annotations

import json
import os
import time

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import torch

from stages.config.stages import ARCHITECTURES
from stages.translation.losses import translation_losses
from stages.translation.networks import Translator, make_translator

PAIRS, FRAMES = 16, 4  # as in the quick preset
ROUNDS = 15


def clip_wise(model: Translator, videos: torch.Tensor, source: torch.Tensor) -> torch.Tensor:
    """The loss as training computes it."""
    return sum(translation_losses(model, videos[:, 1:], videos[:, 0], [source]).values())


def frame_by_frame(model: Translator, videos: torch.Tensor, source: torch.Tensor) -> torch.Tensor:
    """The same loss, each frame of each pair on its own: (source frame, target frame, context) triples."""
    model.plain = True
    frames = videos.shape[1] - 1
    targets, sources = videos[:, 1:].flatten(0, 1), videos[source, 1:].flatten(0, 1)
    context = model.encode_context(videos[:, 0].repeat_interleave(frames, dim=0))
    z3, own = model.translate(model.encode(sources), context), model.encode(targets)
    trans = (model.decode(z3, context) - targets).square().sum() / len(targets)
    rec = (model.decode(own, context) - targets).square().sum() / len(targets)
    align = (z3 - own).square().sum() / len(targets)
    model.plain = False
    return trans + rec + align


def seconds(loss, model: Translator, videos: torch.Tensor, source: torch.Tensor) -> float:
    """Seconds of one forward and backward pass."""
    start = time.perf_counter()
    loss(model, videos, source).backward()
    return time.perf_counter() - start


def measure(arch: str) -> dict[str, float]:
    """Medians over interleaved rounds, so that a busy moment hits both forms."""
    torch.manual_seed(0)
    model = make_translator(arch, (48, 48))
    videos = torch.rand(PAIRS, FRAMES + 1, 3, 48, 48) * 2 - 1
    source = torch.arange(PAIRS).roll(1)
    model.eval()  # Dropout, where there is any, would differ.
    torch.testing.assert_close(clip_wise(model, videos, source), frame_by_frame(model, videos, source))
    model.train()
    times: dict[str, list[float]] = {"clip": [], "frame": []}
    for _ in range(ROUNDS):
        times["frame"].append(seconds(frame_by_frame, model, videos, source))
        times["clip"].append(seconds(clip_wise, model, videos, source))
    clip, frame = (sorted(times[name])[ROUNDS // 2] for name in ("clip", "frame"))
    return {
        f"{arch}_clip_ms": round(1e3 * clip, 1),
        f"{arch}_frame_ms": round(1e3 * frame, 1),
        f"{arch}_ratio": round(frame / clip, 2),
    }


def main() -> None:
    figures = {key: value for arch in ARCHITECTURES for key, value in measure(arch).items()}
    print(json.dumps({"benchmark": "translator_step", "pairs": PAIRS, "frames": FRAMES, **figures}))


if __name__ == "__main__":
    main()
