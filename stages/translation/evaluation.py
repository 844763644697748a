"""Metrics of a translator on held-out demonstrations, compared with copying the context frame."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from artifacts import tile_videos
from stages.translation.layers import evaluating
from stages.translation.metrics import feature_ratio, psnr, squared_error, ssim
from stages.translation.networks import Translator, to_frames, to_images

CHUNK = 8  # videos evaluated at once
DRAWN, MOMENTS = 3, 5  # translations in a picture, and frames of each
DRAWN_HEIGHT = 96  # pixels; smaller frames are enlarged to about this height


@torch.no_grad()
def evaluate_translator(model: Translator, frames: Tensor, device: str) -> dict[str, float]:
    """Translate each held-out demonstration into the context of the previous one, without dropout.

    Args:
        model: The translator.
        frames: Held-out demonstrations (N, T, H, W, 3), uint8; at least two.
        device: Torch device of the model.

    Returns:
        Means over frames 1..T-1 (frame 0 is the context itself) of `psnr` (dB), `ssim`, `trans`, `rec` (sums of
        squared differences per frame, pixels in [0, 1]) and `align` (sum of squared differences over features); the
        same metrics for copying the context frame (`copy_psnr`, `copy_ssim`, `copy_trans`) or its features
        (`copy_align`); and the median of `feature_ratio`.
    """
    with evaluating(model):
        return _evaluate(model, frames, device)


def _evaluate(model: Translator, frames: Tensor, device: str) -> dict[str, float]:
    count = len(frames)
    totals: dict[str, list[Tensor]] = {}
    for start in range(0, count, CHUNK):
        index = torch.arange(start, min(start + CHUNK, count))
        target = to_images(frames[index].to(device))
        source = to_images(frames[(index + 1) % count].to(device))
        videos, times = target.shape[:2]
        context = model.encode_context(target[:, 0])
        features = model.encode(target.flatten(0, 1))
        z3 = model.translate(model.encode(source.flatten(0, 1)), context)
        translated = model.decode(z3, context).unflatten(0, (videos, times))[:, 1:]
        decoded = model.decode(features, context).unflatten(0, (videos, times))[:, 1:]
        truth, copied = target[:, 1:], target[:, :1].expand(-1, times - 1, -1, -1, -1)
        z, z3 = features.unflatten(0, (videos, times)), z3.unflatten(0, (videos, times))
        values = {
            "psnr": psnr(translated, truth),
            "copy_psnr": psnr(copied, truth),
            "ssim": ssim(translated.flatten(0, 1), truth.flatten(0, 1)),
            "copy_ssim": ssim(copied.flatten(0, 1), truth.flatten(0, 1)),
            "trans": squared_error(translated, truth),
            "copy_trans": squared_error(copied, truth),
            "rec": squared_error(decoded, truth),
            "align": (z3 - z).square().sum(dim=-1)[:, 1:],
            "copy_align": (z[:, :1] - z).square().sum(dim=-1)[:, 1:],
            "feature_ratio": feature_ratio(z3, z),
        }
        for name, value in values.items():
            totals.setdefault(name, []).append(value.flatten())
    joined = {name: torch.cat(parts) for name, parts in totals.items()}
    return {name: float(v.median() if name == "feature_ratio" else v.mean()) for name, v in joined.items()}


@torch.no_grad()
def draw_translations(model: Translator, frames: Tensor, device: str) -> np.ndarray:
    """Draw the first held-out demonstrations translated as by `evaluate_translator`.

    Args:
        model: The translator.
        frames: Held-out demonstrations (N, T, H, W, 3), uint8; at least two.
        device: Torch device of the model.

    Returns:
        A picture (H', W', 3), uint8: for each translation, rows of frames at evenly spaced times of the source, of the
        translation, and of the true video in that context.
    """
    count = len(frames)
    moments = torch.linspace(0, frames.shape[1] - 1, min(MOMENTS, frames.shape[1])).round().long()
    rows: list[list[np.ndarray | str]] = []
    with evaluating(model):
        for k in range(min(DRAWN, count)):
            source, truth = frames[(k + 1) % count][moments], frames[k][moments]
            context = model.encode_context(to_images(frames[k][:1].to(device)))
            translated = model.decode(model.translate(model.encode(to_images(source.to(device))), context), context)
            for shown in (source, to_frames(translated.cpu()), truth):
                rows.append(list(shown.numpy()))
    labels = ["source", "translation", "true video"] * (len(rows) // 3)
    return tile_videos(rows, scale=max(1, DRAWN_HEIGHT // frames.shape[2]), row_labels=labels)[0]
