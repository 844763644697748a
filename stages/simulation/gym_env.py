"""A dm_control environment of this package as a Gymnasium environment, through shimmy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from dm_control.rl import control
from gymnasium.utils import EzPickle
from shimmy import DmControlCompatibilityV0


class SuiteEnv(DmControlCompatibilityV0):
    """Shimmy's environment, with what it leaves open mended.

    Seeds are Gymnasium's: `reset(seed=s)` starts at episode 0 of seed s, the same as the batch and dm_control
    draw. `np_random` is a Generator, `close` may be called twice, `render_fps` counts control steps a second.
    An episode ends by truncation, never by termination. `info["normalised_distance"]` is the paper's metric.
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
        EzPickle.__init__(self, env, render_mode, render_size)  # Shimmy's call recorded its own arguments.
        self.metadata["render_fps"] = round(1.0 / env.control_timestep())
        self._closed = False

    # Shimmy replaces Gymnasium's generator by the task's RandomState.
    np_random = gymnasium.Env.np_random

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode; its number follows from the resets since the last seed."""
        gymnasium.Env.reset(self, seed=seed)
        if seed is not None:
            self._env.task.seed(seed)
        return self._in_order(self._env.reset().observation), self._info()

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Hold `action` for a control step."""
        observation, reward, terminated, truncated, _ = super().step(action)
        return self._in_order(observation), float(reward), terminated, truncated, self._info()

    def _in_order(self, observation: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The observation in its space's order, which is the alphabet's."""
        return {name: observation[name] for name in self.observation_space}

    def _info(self) -> dict[str, Any]:
        return {"normalised_distance": self._env.task.normalised_distance(self._env.physics)}

    def close(self) -> None:
        """Free the GL context."""
        if not self._closed:
            self._closed = True
            super().close()
