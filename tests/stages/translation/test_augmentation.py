"""Augmentation changes each training video as a whole, follows from the seed, and touches nothing else."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from stages.config.stages import TranslatorConfig
from stages.translation import augmentation
from stages.translation.augmentation import augmented
from stages.translation.training import TranslatorTraining

SIZE = 32
CONFIG = TranslatorConfig(steps=20, videos=6, frames=3, mirror=False, swap_colours=False, augment=True)


def still(n: int, frames: int = 4) -> torch.Tensor:
    """Videos (n, frames, 3, SIZE, SIZE) in which nothing happens: what two frames differ in, augmentation did."""
    pictures = torch.rand(n, 1, 3, SIZE, SIZE, generator=torch.Generator().manual_seed(0)) - 0.5
    return pictures.expand(-1, frames, -1, -1, -1)


def frames(n: int) -> torch.Tensor:
    return torch.randint(0, 256, (n, 5, 16, 16, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(1))


def test_every_frame_of_a_video_is_changed_alike_and_every_video_in_its_own_way():
    changed = augmented(still(8), np.random.default_rng(0))
    assert torch.equal(changed, changed[:, :1].expand_as(changed)), "frame t as frame 0, its context"
    alike = augmented(still(1).expand(8, -1, -1, -1, -1), np.random.default_rng(0))
    assert len({tuple(video.flatten().tolist()) for video in alike}) == 8


def only(monkeypatch, *kept):
    """Switch off all changes but some."""
    for name in {"BRIGHTNESS", "CONTRAST", "SATURATION", "ROTATION", "ZOOM", "SHIFT"} - set(kept):
        monkeypatch.setattr(augmentation, name, 0.0)


def spot(height: int, width: int, row: float, column: float) -> torch.Tensor:
    """A video (1, 2, 3, height, width) of a soft bright spot at a position in pixels from the middle of the frame."""
    rows, columns = torch.arange(height) - (height - 1) / 2, torch.arange(width) - (width - 1) / 2
    square = (rows[:, None] - row) ** 2 + (columns - column) ** 2
    return (2 * torch.exp(-square / 8) - 1).expand(1, 2, 3, -1, -1)


def found(video: torch.Tensor) -> tuple[float, float]:
    """Where the spot in a video is: its center of mass, in pixels from the middle of the frame."""
    light = video[0, 0].double() + 1
    height, width = light.shape
    rows, columns = torch.arange(height) - (height - 1) / 2, torch.arange(width) - (width - 1) / 2
    return float((light * rows[:, None]).sum() / light.sum()), float((light * columns).sum() / light.sum())


@pytest.mark.parametrize(("height", "width"), [(64, 64), (48, 80)])
@pytest.mark.parametrize(
    ("angle", "magnification", "right", "down"), [(30, 1, 0, 0), (0, 1.2, 0, 0), (-20, 0.8, 0.1, -0.05)]
)
def test_moves_what_is_seen_as_a_camera_that_turns_comes_nearer_and_looks_elsewhere(
    height, width, angle, magnification, right, down
):
    row, column = 6.0, 10.0
    values = [torch.tensor([float(value)]) for value in (math.radians(angle), magnification, right, down)]
    moved = augmentation._moved(spot(height, width, row, column), *values)
    cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    expected = (
        magnification * (sin * column + cos * row) + down * height,  # rows run downward: clockwise
        magnification * (cos * column - sin * row) + right * width,
    )
    assert found(moved[0]) == pytest.approx(expected, abs=0.1)


def test_moves_at_most_as_far_as_the_bounds(monkeypatch):
    only(monkeypatch, "SHIFT")
    videos = spot(64, 64, 0, 0).expand(200, -1, -1, -1, -1)
    places = np.array([found(video) for video in augmented(videos, np.random.default_rng(0))]) / 64
    assert (abs(places) < augmentation.SHIFT + 0.01).all() and (
        abs(places).max(axis=0) > 0.9 * augmentation.SHIFT
    ).all()
    only(monkeypatch, "ROTATION")
    monkeypatch.setattr(augmentation, "ROTATION", 30.0)
    videos = spot(64, 64, 0, 15).expand(200, -1, -1, -1, -1)
    turns = np.array([math.degrees(math.atan2(*found(video))) for video in augmented(videos, np.random.default_rng(0))])
    assert abs(turns).max() < 31 and turns.min() < -27 < 27 < turns.max()
    only(monkeypatch, "ZOOM")
    monkeypatch.setattr(augmentation, "ZOOM", 0.2)
    distances = np.array([found(video)[1] / 15 for video in augmented(videos, np.random.default_rng(0))])
    assert 0.8 < distances.min() < 0.85 and 1.18 < distances.max() < 1.24


def test_border_pixels_are_repeated(monkeypatch):
    only(monkeypatch, "SHIFT", "ROTATION", "ZOOM")
    white = torch.ones(16, 2, 3, SIZE, SIZE)
    assert torch.allclose(augmented(white, np.random.default_rng(0)), white)


def test_changes_light_and_colours_a_little_and_keeps_the_range(monkeypatch):
    only(monkeypatch, "BRIGHTNESS", "CONTRAST", "SATURATION")
    videos = still(64)
    changed = augmented(videos, np.random.default_rng(0))
    apart = (changed - videos).flatten(1).abs()
    assert (apart.mean(dim=1) > 0.005).all() and apart.max() < 0.4
    bright = augmented(torch.ones(64, 2, 3, SIZE, SIZE), np.random.default_rng(0))
    assert bright.max() == 1.0 and bright.min() > 0.8
    grey = augmented(videos.mean(dim=2, keepdim=True).expand_as(videos), np.random.default_rng(0))
    assert torch.allclose(grey, grey[:, :, :1].expand_as(grey), atol=1e-6), "grey stays grey"


def test_context_and_frames_of_a_training_batch_are_changed_alike():
    videos = frames(12)
    videos[:] = videos[:, :1].clone()
    training = TranslatorTraining(CONFIG, videos, 3, "cpu")
    shown, contexts, *_ = training._batch()
    assert torch.equal(shown, contexts[:, None].expand_as(shown))
    plain = TranslatorTraining(dataclasses.replace(CONFIG, augment=False), videos, 3, "cpu")._batch()
    assert not torch.equal(contexts, plain[1])
    training.step = 1
    assert not torch.equal(training._batch()[1], contexts)
    assert not torch.equal(training._batch(1)[1], training._batch(0)[1])


def test_leaves_what_else_is_drawn_for_a_batch_as_it_was():
    on, off = (
        TranslatorTraining(dataclasses.replace(CONFIG, augment=augment), frames(12), 3, "cpu")._batch()
        for augment in (True, False)
    )
    assert torch.equal(on[2][0], off[2][0]) and torch.equal(on[3], off[3])
    assert not torch.equal(on[0], off[0])


def test_the_videos_themselves_stay_as_they_are():
    videos = frames(12)
    before = videos.clone()
    training = TranslatorTraining(CONFIG, videos, 3, "cpu")
    training.train_step()
    assert torch.equal(videos, before)
