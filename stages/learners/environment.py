"""A batch of simulations as a Stable-Baselines3 VecEnv whose episodes start and end together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from stages.learners.reward import Reward
from stages.runtime.seeding import generator
from stages.simulation.batch import BatchSimulation
from stages.simulation.contexts import Contexts
from stages.simulation.task import State, Task


class EpisodeEnv(VecEnv):
    """`nsim` simulations of a task; each call of `step` runs one control step in all of them.

    The contexts and initial states of an episode depend only on the seed and the episode number. To resume a run, set
    `episode` and call `reset`.

    Attributes:
        episode: Number of the episode that the next `reset` starts.
        state: Current state; at the end of an episode, the initial state of the next one.
        final: Final state of the last episode.
        contexts: Contexts of the current episode.
        distances: Normalized final distances (nsim,) of each batch of episodes that ended since `pop_distances`.
    """

    render_mode = None

    def __init__(
        self,
        task: Task,
        nsim: int,
        seed: int,
        contexts: Callable[[np.random.Generator, int], Contexts],
        reward: Reward,
        expert: bool = False,
        nthread: int = 0,
    ):
        self.task = task
        self.reward = reward
        self.episode = 0
        self._seed = seed
        self._draw_contexts = contexts
        self._expert = expert
        self._simulation = BatchSimulation(task, nsim, nthread)
        self.contexts: Contexts = {}
        self._distances: list[np.ndarray] = []
        self._actions = np.zeros((nsim, task.action_size))
        self._step = 0
        self.distances: list[np.ndarray] = []
        self.observation_size = self._reset_all().shape[1]
        self.final = self.state
        self.episode = 0
        observation_space = spaces.Box(-np.inf, np.inf, (self.observation_size,), np.float32)
        super().__init__(nsim, observation_space, spaces.Box(-1.0, 1.0, (task.action_size,), np.float32))

    def _observe(self, state: State) -> np.ndarray:
        return self.task.observe_expert(state, self.contexts) if self._expert else self.task.observe(state)

    def _reset_all(self) -> np.ndarray:
        rng = generator(self._seed, "episode", self.episode)
        self.contexts = self._draw_contexts(rng, self._simulation.nsim)
        state = self.state = self._simulation.reset(*self.task.draw_states(rng, self.contexts))
        self._distances = [self.task.distance(state, self.contexts)]
        self._step = 0
        self.episode += 1
        return self._observe(state)

    def reset(self) -> np.ndarray:
        return self._reset_all()

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        state = self.state = self._simulation.step(self._actions)
        self._step += 1
        rewards = self.reward(self._step, state, self._actions, self.contexts)
        done = self._step == self.task.control_steps
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        observation = self._observe(state)
        self._distances.append(self.task.distance(state, self.contexts))
        if done:
            initial, final = self.task.outcome(np.stack(self._distances, axis=1))
            self.distances.append(final / initial)
            for info, last in zip(infos, observation, strict=True):
                info["terminal_observation"] = last
                info["TimeLimit.truncated"] = self.task.truncates
            self.final = state
            observation = self._reset_all()
        return observation, rewards.astype(np.float32), np.full(self.num_envs, done), infos

    def pop_distances(self) -> np.ndarray:
        """Normalized final distances (m,) of all episodes that ended since the last call."""
        ended = np.concatenate(self.distances) if self.distances else np.empty(0)
        self.distances = []
        return ended

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
