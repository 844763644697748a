"""The interface of environments to learners and rewards.

An environment is a Stable-Baselines3 `VecEnv` of n episodes that run in lockstep: all start and end at the same control
step. Rewards see a `Moment`: frames and observations, never the simulator.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from stages.environments.timing import Timing

if TYPE_CHECKING:
    from stages.learners.reward import Reward


class Moment(Protocol):
    """What n environments show after the same control step."""

    @property
    def step(self) -> int:
        """Control steps since the start of the episode: 0, 1, ..."""
        ...

    @property
    def observation(self) -> np.ndarray:
        """Observations (n, D) of the learner."""
        ...

    def frames(self) -> np.ndarray:
        """Frames (n, H, W, 3), uint8. Rewards ask for them only at the control steps in `Timing.frame_steps`."""
        ...


class Environment(VecEnv, ABC):
    """`num_envs` episodes in lockstep; each call of `step` runs one control step in all of them.

    Episodes depend only on the environment and the episode number. To resume a run, set `episode` and call `reset`.

    Attributes:
        name: Name of the task or environment, for messages.
        timing: Length of an episode, and its frames.
        reward: What the learner is paid.
        rounds: Episodes of each of the `num_envs` environments per iteration of a learner.
        truncates: Whether an episode is truncated at its end, so that values bootstrap beyond it.
        has_clock: Whether the last entry of the observation, and no other, is time relative to the episode length.
        episode: Number of the episode that the next `reset` starts.
        moment: The current moment; at the end of an episode, the first one of the next episode.
        last: The last moment of the episode that ended last.
    """

    render_mode = None
    has_clock = True

    def __init__(
        self,
        name: str,
        num_envs: int,
        timing: Timing,
        reward: Reward,
        action_size: int,
        rounds: int = 1,
        truncates: bool = False,
    ):
        self.name, self.timing, self.reward = name, timing, reward
        self.rounds, self.truncates = rounds, truncates
        self.num_envs = num_envs
        self._actions = np.zeros((num_envs, action_size))
        self.episode = 0
        self.moment = self.last = self._start()
        self.episode = 0  # The first reset of a new environment does not count as an episode.
        self.action_size, self.observation_size = action_size, self.moment.observation.shape[1]
        observation_space = spaces.Box(-np.inf, np.inf, (self.observation_size,), np.float32)
        super().__init__(num_envs, observation_space, spaces.Box(-1.0, 1.0, (action_size,), np.float32))

    @abstractmethod
    def begin(self) -> Moment:
        """Start episode number `episode` in all environments."""

    @abstractmethod
    def advance(self, actions: np.ndarray) -> Moment:
        """Run one control step with `actions` (n, nu), in [-1, 1], in all environments."""

    @abstractmethod
    def record(self) -> None:
        """Record the outcome of the episode that has just ended, for `pop_figures`."""

    @abstractmethod
    def pop_figures(self) -> dict[str, float]:
        """Mean outcomes of all episodes that ended since the last call, by the name that curves give them."""

    def _start(self) -> Moment:
        moment = self.begin()
        self.episode += 1
        return moment

    def reset(self) -> np.ndarray:
        self.moment = self._start()
        return self.moment.observation

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        moment = self.moment = self.advance(self._actions)
        rewards = self.reward(moment, self._actions)
        done = moment.step == self.timing.control_steps
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        observation = moment.observation
        if done:
            self.record()
            for info, final in zip(infos, observation, strict=True):
                info["terminal_observation"] = final
                info["TimeLimit.truncated"] = self.truncates
            self.last = moment
            observation = self.reset()
        return observation, rewards.astype(np.float32), np.full(self.num_envs, done), infos

    def close(self) -> None:
        self.reward.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        return [getattr(self, method_name)(*method_args, **method_kwargs)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs
