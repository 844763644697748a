"""A task without physics, whose frames a test chooses."""

from types import SimpleNamespace

import numpy as np
import pytest

T, SIZE = 6, 16


class Pool:
    """Draws what it is told to, whatever the joints are."""

    def __init__(self):
        self.frames = np.zeros((1, SIZE, SIZE, 3), np.uint8)

    def render(self, fields, qpos):
        return self.frames[None]

    def close(self):
        pass


@pytest.fixture
def stage():
    """Draws videos (n, T, H, W, 3) for a reward, and hands its rewards back; `reward` is set by the test."""
    task = SimpleNamespace(
        model_fields=lambda contexts: {}, frame_every=2, frames=T, frame_size=(SIZE, SIZE), control_steps=2 * T
    )
    pool = Pool()

    def perform(reward, videos):
        """Rewards (n, T - 1) of frames 1, ..., T - 1."""
        got = []
        for step in range(1, task.control_steps + 1):
            pool.frames = videos[:, min(step // 2, T - 1)]
            given = reward(step, SimpleNamespace(qpos=np.zeros((len(videos), 1))), None, {})
            if step % 2 == 0 and step // 2 < T:
                got.append(given)
            else:
                assert not given.any()
        return np.stack(got, axis=1)

    return SimpleNamespace(task=task, pool=pool, perform=perform)


@pytest.fixture
def squares():
    """A function that films a square which moves right along a row, or stands still, before a background."""

    def film(row, n=8, speed=2, background=0, seed=0):
        frames = np.random.default_rng(seed).integers(0, 30, (n, T, SIZE, SIZE, 3), dtype=np.uint8) + background
        for t in range(T):
            frames[:, t, row : row + 4, speed * t : speed * t + 4] = 255
        return frames.astype(np.uint8)

    return film
