"""Plays policies in environments."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stages.environments.protocol import Environment

Act = Callable[[np.ndarray], np.ndarray]


def play(env: Environment, act: Act, frames: bool = True) -> np.ndarray:
    """Play one episode in every environment, with actions (n, nu) = `act`(observations (n, D)).

    Returns:
        Frames (n, T, H, W, 3), uint8, of the episodes; (0,) without `frames`.
    """
    env.reset()
    seen = [env.moment.frames()] if frames else []
    for step in range(1, env.timing.control_steps + 1):
        _, _, done, _ = env.step(act(env.moment.observation))
        if frames and env.timing.frame_at(step) is not None:
            seen.append((env.last if done[0] else env.moment).frames())
    return np.stack(seen, axis=1) if seen else np.empty(0)
