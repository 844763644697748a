"""A Gymnasium environment without physics: a square that slides along a line, with faults to choose."""

from __future__ import annotations

from typing import ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

SIDE = 32


class Slide(gymnasium.Env):
    """Starts at a place that the seed selects; an episode succeeds while the square is at the right end.

    Args:
        limit: Steps after which it says `truncated`; 0: never.
        ends: Whether it terminates on leaving the line, as environments with negative rewards invite to.
        report: Name of the flag of success in `info`; empty: none.
        broken: What fails: `reset`, `step`, `render`, `frame` (no image), `observation` (NaN); empty: nothing.
        still: Whether frames never change.
        dictionary: Whether the observation is a dictionary with an image beside the state.
    """

    metadata: ClassVar = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self,
        limit=10,
        ends=False,
        report="is_success",
        broken="",
        still=False,
        dictionary=False,
        render_mode="rgb_array",
        width=SIDE,
        height=SIDE,
    ):
        self.render_mode, self.max_path_length = render_mode, limit
        self._ends, self._report, self._broken, self._still, self._dictionary = ends, report, broken, still, dictionary
        self._size = height, width
        state = spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.observation_space = state
        if dictionary:
            image = spaces.Box(0, 255, (height, width, 3), np.uint8)
            self.observation_space = spaces.Dict({"pixels": image, "state": state})
        self.action_space = spaces.Box(np.array([-2.0, 0.0], np.float32), np.array([2.0, 1.0], np.float32))
        self._x, self._steps = 0.0, 0

    def _observe(self):
        state = np.array([self._x, np.nan if self._broken == "observation" and self._steps else 1.0])
        return {"pixels": self._draw(), "state": state} if self._dictionary else state

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if self._broken == "reset":
            raise RuntimeError("cannot reset")
        self._x, self._steps = float(self.np_random.uniform(-0.5, 0.0)), 0
        return self._observe(), {}

    def step(self, action):
        if self._broken == "step":
            raise RuntimeError("cannot step")
        if self._broken == "exit":
            raise SystemExit(0)
        self._steps += 1
        self._x += 0.05 * float(action[0])
        terminated = self._ends and abs(self._x) > 1
        self._x = float(np.clip(self._x, -1, 1))
        info = {self._report: self._x > 0.3} if self._report else {}
        return self._observe(), self._x - 1, bool(terminated), bool(self._steps == self.max_path_length), info

    def _draw(self):
        height, width = self._size
        image = np.full((height, width, 3), 40, np.uint8)
        left = round((0.0 if self._still else self._x + 1) / 2 * (width - width // 4))
        image[height // 4 : height // 2, left : left + width // 4] = 230
        return image

    def render(self):
        if self._broken == "render":
            raise RuntimeError("cannot render")
        return None if self._broken == "frame" else self._draw()


def unbounded(render_mode="rgb_array"):
    """Actions without bounds."""
    env = Slide()
    env.action_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)
    return env


def discrete(render_mode="rgb_array"):
    """Actions to choose from."""
    env = Slide()
    env.action_space = spaces.Discrete(3)
    return env


def blind():
    """No images."""
    return Slide(render_mode=None)


def number():
    """No environment at all."""
    return 3


def failing():
    """Code that fails."""
    raise KeyError("model.xml")


def go_right(observation):
    """A demonstrator that pushes the square to the right."""
    return np.array([2.0, 0.0])


def go_left(observation):
    """A demonstrator that always fails."""
    return np.array([-1.0, 0.0])


def stumble(observation):
    """A demonstrator whose code fails."""
    raise IndexError("no such action")


class Remembering:
    """A demonstrator with `get_action`, as in Meta-World."""

    def get_action(self, observation):
        return [2.0, 0.0]


def is_far(observation, info):
    """A success that the environment does not report."""
    state = observation["state"] if isinstance(observation, dict) else observation
    return state[0] > 0.9 and "success" not in info


def unsure(observation, info):
    """A judge whose code fails."""
    raise KeyError("goal")


def lame(observation):
    """A demonstrator whose actions are none."""
    return np.array([np.nan, 0.0])


class Script:
    """A demonstrator that plays back actions from the start of every episode."""

    def __init__(self):
        self._step = 0

    def reset(self):
        self._step = 0

    def __call__(self, observation):
        self._step += 1
        return np.array([2.0 if self._step < 4 else -0.5, 0.0])
