"""A timing without a simulation, and moments whose frames a test chooses."""

from types import SimpleNamespace

import numpy as np
import pytest

from stages.environments.timing import Timing

T, SIZE = 6, 16


@pytest.fixture
def stage():
    """Draws videos (n, T, H, W, 3) for a reward, and hands its rewards back; `reward` is set by the test."""
    timing = Timing.regular(2 * T, 2)

    def moment(step, frames):
        """A moment that shows `frames` (n, H, W, 3)."""
        return SimpleNamespace(step=step, observation=np.zeros((len(frames), 1)), frames=lambda: frames)

    def perform(reward, videos):
        """Rewards (n, T - 1) of frames 1, ..., T - 1."""
        got = []
        for step in range(1, timing.control_steps + 1):
            given = reward(moment(step, videos[:, min(step // 2, T - 1)]), None)
            if step % 2 == 0 and step // 2 < T:
                got.append(given)
            else:
                assert not given.any()
        return np.stack(got, axis=1)

    return SimpleNamespace(timing=timing, moment=moment, perform=perform)


@pytest.fixture
def squares():
    """A function that films a square which moves right along a row, or stands still, before a background."""

    def film(row, n=8, speed=2, background=0, seed=0):
        frames = np.random.default_rng(seed).integers(0, 30, (n, T, SIZE, SIZE, 3), dtype=np.uint8) + background
        for t in range(T):
            frames[:, t, row : row + 4, speed * t : speed * t + 4] = 255
        return frames.astype(np.uint8)

    return film
