"""Augmentation changes each training video as a whole, follows from the seed, and touches nothing else."""

import dataclasses

import numpy as np
import torch

from stages.config.stages import TranslatorConfig
from stages.translation import augmentation
from stages.translation.augmentation import augmented
from stages.translation.training import TranslatorTraining

SIZE = 32
MOST = round(augmentation.SHIFT * SIZE)
CONFIG = TranslatorConfig(steps=20, videos=6, frames=3, mirror=False, swap_colours=False, augment=True)


def still(n: int, frames: int = 4) -> torch.Tensor:
    """Videos (n, frames, 3, SIZE, SIZE) in which nothing happens: what two frames differ in, augmentation did."""
    pictures = torch.rand(n, 1, 3, SIZE, SIZE, generator=torch.Generator().manual_seed(0)) - 0.5
    return pictures.expand(-1, frames, -1, -1, -1)


def moved(video: torch.Tensor, rows: int, columns: int) -> torch.Tensor:
    """A video (F, 3, SIZE, SIZE) shifted down and to the right."""
    row, column = ((torch.arange(SIZE) - by).clamp(0, SIZE - 1) for by in (rows, columns))
    return video[..., row, :][..., column]


def frames(n: int) -> torch.Tensor:
    return torch.randint(0, 256, (n, 5, 16, 16, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(1))


def test_every_frame_of_a_video_is_changed_alike_and_every_video_in_its_own_way():
    changed = augmented(still(8), np.random.default_rng(0))
    assert torch.equal(changed, changed[:, :1].expand_as(changed)), "frame t as frame 0, its context"
    alike = augmented(still(1).expand(8, -1, -1, -1, -1), np.random.default_rng(0))
    assert len({tuple(video.flatten().tolist()) for video in alike}) == 8


def test_shifts_by_a_few_whole_pixels_and_the_border_goes_on(monkeypatch):
    for name in ("BRIGHTNESS", "CONTRAST", "SATURATION"):
        monkeypatch.setattr(augmentation, name, 0.0)
    videos = still(64)
    found = set()
    offsets = range(-MOST, MOST + 1)
    for video, changed in zip(videos, augmented(videos, np.random.default_rng(0)), strict=True):
        shifts = [(r, c) for r in offsets for c in offsets if torch.allclose(changed, moved(video, r, c), atol=1e-6)]
        assert len(shifts) == 1
        found.update(shifts)
    assert {row for row, _ in found} == {column for _, column in found} == set(offsets)


def test_changes_light_and_colours_a_little_and_keeps_the_range(monkeypatch):
    monkeypatch.setattr(augmentation, "SHIFT", 0.0)
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
