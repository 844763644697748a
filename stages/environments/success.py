"""Whether an episode in a Gymnasium environment succeeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium


class Judged(gymnasium.Wrapper):
    """An environment whose success a user's function of the last observation and `info` decides."""

    def __init__(self, env: gymnasium.Env, judge: Callable[[Any, Mapping[str, Any]], Any]):
        super().__init__(env)
        self._judge = judge

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        others = {name: value for name, value in info.items() if name != "success"}
        info = {**others, "is_success": bool(self._judge(observation, info))}
        return observation, reward, terminated, truncated, info


class Success:
    """Success of an episode, as the environment reports it.

    `info["success"]` counts if it was true at any step (as in Meta-World), or else `info["is_success"]` at the last one
    (as in Gymnasium-Robotics and Stable-Baselines3).

    Attributes:
        value: Whether the episode succeeds so far; None: it is not known.
    """

    def __init__(self) -> None:
        self.value: bool | None = None

    def reset(self) -> None:
        """Begin an episode."""
        self.value = None

    def see(self, info: Mapping[str, Any]) -> None:
        """Take note of a step."""
        if "success" in info:
            self.value = bool(self.value) or bool(info["success"])
        elif "is_success" in info:
            self.value = bool(info["is_success"])
