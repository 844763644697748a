"""The grid of a translation says what its rows and columns are."""

from __future__ import annotations

import numpy as np
import pytest

from stages.reporting import grids
from stages.reporting.grids import translation_grid


@pytest.fixture
def arrays():
    shades = np.arange(1, 4, dtype=np.uint8)[:, None, None, None, None] * 20
    return {
        "context_frame": np.full((8, 8, 3), 100, np.uint8),
        "images": np.broadcast_to(shades, (3, 5, 8, 8, 3)),
        "demonstrations": np.array([7, 12, 30]),
        "target_images": np.full((5, 8, 8, 3), 39.6),
    }


@pytest.fixture
def tiled(monkeypatch):
    """What `tile_videos` is asked for."""
    asked = {}

    def tile(rows, **options):
        asked.update(options, rows=rows)
        return np.zeros((5, 2, 2, 3), np.uint8)

    monkeypatch.setattr(grids, "tile_videos", tile)
    return asked


def test_rows_and_columns_have_names(arrays, tiled):
    sources = [np.full((5, 8, 8, 3), 200, np.uint8), "not available"]
    translation_grid(sources, arrays, 16, scale=3)
    assert tiled["labels"] == ["source", "context", "translation"] and tiled["scale"] == 3
    assert tiled["row_labels"] == ["demo 7", "demo 12", "target"]
    assert [row[0] if isinstance(row[0], str) else row[0].max() for row in tiled["rows"]] == [
        200,
        "not available",
        "mean of 16",
    ]
    assert [row[1].max() for row in tiled["rows"]] == [100, 100, 100]
    assert [row[2].max() for row in tiled["rows"]] == [20, 40, 40]


def test_the_experts_own_video_and_untranslated_targets_are_named(arrays, tiled):
    expert = np.full((5, 8, 8, 3), 9, np.uint8)
    translation_grid([expert], {**arrays, "expert_frames": expert}, 1, untranslated=True)
    assert tiled["labels"] == ["source", "context", "untranslated", "expert here"]
    assert all(row[3] is expert for row in tiled["rows"])


def test_no_cell_is_black(arrays):
    shown = translation_grid([np.full((5, 8, 8, 3), 200, np.uint8)], arrays, 3, scale=20)
    assert shown.shape[0] == 5 and shown.dtype == np.uint8
    bottom = shown[0, -160:, -3 * 160 - 4 :]
    assert bottom[:, :160].mean() > 200, "the text that stands for the mean's source"
    assert (bottom[:, 162:322] == 100).all() and (bottom[:, 324:] == 40).all()
