"""One environment in a worker process: episodes of a fixed length, with a clock, frames and an outcome."""

from __future__ import annotations

import multiprocessing
import os
import signal
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from artifacts import UsageError
from stages.environments.making import EnvironmentFault, fault, frame_of, make_environment, rendered
from stages.environments.spec import EnvironmentSpec
from stages.environments.success import Success


class Lockstep(gymnasium.Wrapper):
    """Episodes of exactly `spec.control_steps` steps, all in the same context.

    - Every `reset` uses the seed of the context.
    - The last entry of the observation is the time, from 0 to 1.
    - An environment that ends early stands still in its last observation and frame until the end, without reward.
    - At the control steps of frames, `info["frame"]` is the frame (H, W, 3).
    - After the last step, `info["outcome"]` has `env_return` and, if it is known, `success`.
    - If the environment's code fails, `info["fault"]` describes it in one line, and the rest of the episode is void.
    """

    def __init__(self, env: gymnasium.Env, spec: EnvironmentSpec, shown: range | None = None):
        """Wrap `env`.

        Args:
            env: The environment, with flat observations.
            spec: What it was made from.
            shown: Indices of the frames to take; None: all.
        """
        super().__init__(env)
        self._spec, self._timing = spec, spec.timing
        self._shown_frames = range(spec.frames) if shown is None else shown
        space = env.observation_space
        assert isinstance(space, spaces.Box)
        self._size = space.shape[0]
        self.observation_space = spaces.Box(-np.inf, np.inf, (self._size + 1,), np.float32)
        self._observed = np.zeros(self._size, np.float32)
        self._step = 0
        self._ended = False
        self._frame: np.ndarray | None = None
        self._return = 0.0
        self._success = Success()
        self._fault = ""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self._step, self._ended, self._return, self._frame = 0, False, 0.0, None
        self._success.reset()
        info: dict[str, Any] = {}
        where = "reset"
        try:
            self._observed = self._checked(self.env.reset(seed=self._spec.seed)[0])
            where = "render"
            if 0 in self._shown_frames:
                info["frame"] = self._shown()
        except (Exception, SystemExit) as error:
            self._fail(where, error)
        return self._observation(), self._told(info)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self._step += 1
        reward = 0.0
        info: dict[str, Any] = {}
        if not self._ended:
            try:
                reward = self._advance(action)
            except (Exception, SystemExit) as error:
                self._fail("step", error)
        if self._timing.frame_at(self._step) in self._shown_frames and not self._fault:
            try:
                info["frame"] = self._frame if self._ended and self._frame is not None else self._shown()
            except (Exception, SystemExit) as error:
                self._fail("render", error)
        last = self._step == self._spec.control_steps
        if last:
            known = {} if self._success.value is None else {"success": float(self._success.value)}
            info["outcome"] = {"env_return": self._return, **known}
        return self._observation(), reward, False, last, self._told(info)

    def _advance(self, action: Any) -> float:
        observed, reward, terminated, truncated, info = self.env.step(action)
        self._observed = self._checked(observed)
        self._return += float(reward)
        self._success.see(info)
        if terminated or truncated:
            self._ended = True
            if self._shown_frames and self._step < self._spec.control_steps:
                self._frame = self._shown()
        return float(reward)

    def _shown(self) -> np.ndarray:
        return frame_of(rendered(self.env, self._spec), self._spec)

    def _checked(self, observed: Any) -> np.ndarray:
        values = np.asarray(observed, np.float32)
        if values.shape != (self._size,) or not np.isfinite(values).all():
            raise ValueError(f"the observation has shape {values.shape} or is not finite, expected ({self._size},)")
        return values

    def _observation(self) -> np.ndarray:
        return np.append(self._observed, np.float32(self._step / self._spec.control_steps))

    def _fail(self, where: str, error: BaseException) -> None:
        self._ended = True
        self._fault = self._fault or fault(self._spec, self.env, where, error)

    def _told(self, info: dict[str, Any]) -> dict[str, Any]:
        return {**info, "fault": self._fault} if self._fault else info


class Strict(Lockstep):
    """`Lockstep` for use outside of ifo's own processes.

    It renders frames, raises what fails in the environment's code as `EnvironmentFault`, and reports the end of an
    episode as `terminated`: the time is observed, and nothing is to be gained after it.
    """

    _cause: BaseException | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self._fault, self._cause = "", None
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        if self._step >= self._spec.control_steps:
            raise UsageError(f"environment {self._spec.name}: the episode has ended: call reset first")
        observation, reward, _, last, info = super().step(action)
        return observation, reward, last, False, info

    def render(self) -> Any:
        """The frame (H, W, 3), uint8, that the environment shows now."""
        try:
            return self._shown()
        except (Exception, SystemExit) as error:
            raise EnvironmentFault(fault(self._spec, self.env, "render", error)) from error

    def _fail(self, where: str, error: BaseException) -> None:
        super()._fail(where, error)
        self._cause = self._cause or error

    def _told(self, info: dict[str, Any]) -> dict[str, Any]:
        if self._fault:
            raise EnvironmentFault(self._fault) from self._cause
        return info


def make_lockstep(spec: EnvironmentSpec, shown: range | None = None) -> Lockstep:
    """Make the environment of a process, which takes the frames with indices in `shown` (None: all).

    Raises:
        EnvironmentFault: It cannot be made.
    """
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent process, which ends this one.
        os.environ.setdefault("LP_NUM_THREADS", "1")
    return Lockstep(make_environment(spec), spec, shown)
