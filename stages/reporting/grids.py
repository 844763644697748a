"""Translations beside what they were made from, as a video for inspection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from artifacts import tile_videos

SHOWN = 4  # demonstrations in the grid


def translation_grid(
    sources: Sequence[np.ndarray | str],
    arrays: Mapping[str, np.ndarray],
    count: int,
    untranslated: bool = False,
    scale: int = 4,
) -> np.ndarray:
    """Arrange demonstrations, the context, translations and the target in a grid with labels.

    Args:
        sources: The first demonstrations, each (T, H, W, 3), uint8, or a text in its place.
        arrays: Datasets of the translation: `context_frame`, `target_images`, `images` and `demonstrations` (at least
            as many as `sources`), and `expert_frames`, the expert's own video in the context, if there is one.
        count: Number of demonstrations whose mean is the target.
        untranslated: Whether the target is the mean of the demonstrations themselves.
        scale: Integer factor by which frames are enlarged.

    Returns:
        A video (T, H', W', 3), uint8: one row per demonstration, and one for the target.
    """
    context, images = arrays["context_frame"], arrays["images"]
    mean = np.clip(arrays["target_images"], 0, 255).round().astype(np.uint8)
    rows: list[list[np.ndarray | str]] = [[source, context, images[k]] for k, source in enumerate(sources)]
    rows.append([f"mean of {count}", context, mean])
    names = [*(f"demo {number}" for number in arrays["demonstrations"][: len(sources)]), "target"]
    labels = ["source", "context", "untranslated" if untranslated else "translation"]
    if (expert := arrays.get("expert_frames")) is not None:
        rows, labels = [[*row, expert] for row in rows], [*labels, "expert here"]
    return tile_videos(rows, labels=labels, scale=scale, row_labels=names)
