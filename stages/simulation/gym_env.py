"""Wraps a dm_control environment of this package as a Gymnasium environment, using shimmy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from dm_control.rl import control
from gymnasium.utils import EzPickle
from shimmy import DmControlCompatibilityV0


class SuiteEnv(DmControlCompatibilityV0):
    """Shimmy's environment with fixes for its gaps.

    Seeds follow Gymnasium: `reset(seed=s)` starts at episode 0 of seed s, the same episode that the batch simulation
    and dm_control draw. `np_random` is a Generator, `close` may be called twice, and `render_fps` is the number of
    control steps per second. Episodes end by truncation, never by termination. `info["normalised_distance"]` is the
    paper's metric.
    """

    def __init__(
        self,
        env: control.Environment,
        render_mode: str | None = None,
        render_size: tuple[int, int] = (240, 240),
    ):
        self.metadata = {"render_modes": ["rgb_array", "depth_array"], "render_fps": 0}
        height, width = render_size
        super().__init__(env, render_mode, {"camera_id": env.task.task.camera, "height": height, "width": width})
        EzPickle.__init__(self, env, render_mode, render_size)  # Shimmy's constructor recorded its own arguments.
        self.metadata["render_fps"] = round(1.0 / env.control_timestep())

    # Shimmy replaces Gymnasium's generator with the task's RandomState.
    np_random = gymnasium.Env.np_random

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start the next episode. Its number counts the resets since the last seed."""
        gymnasium.Env.reset(self, seed=seed)
        if seed is not None:
            self._env.task.seed(seed)
        return self._in_order(self._env.reset().observation), self._info()

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Apply `action` for one control step."""
        observation, reward, terminated, truncated, _ = super().step(action)
        return self._in_order(observation), float(reward), terminated, truncated, self._info()

    def _in_order(self, observation: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The observation in the order of its space, which is alphabetical."""
        return {name: observation[name] for name in self.observation_space}

    def _info(self) -> dict[str, Any]:
        return {"normalised_distance": self._env.task.normalised_distance(self._env.physics)}

    def close(self) -> None:
        """Free the GL context. The environment may still be used: Stable-Baselines3's `check_env` does so."""
        self._env.physics.free_rendering()
