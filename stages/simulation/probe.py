"""A task under test: contexts, episodes and frames for `stages.simulation.checking`, each computed once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from artifacts.errors import UsageError
from stages.runtime.seeding import generator
from stages.simulation.batch import BatchSimulation, Rollout, drawn_actions, held, rollout
from stages.simulation.blame import TaskError, broken
from stages.simulation.contexts import Contexts, take
from stages.simulation.registry import distribution
from stages.simulation.task import State, Task

if TYPE_CHECKING:
    from stages.simulation.render import RenderPool

SIMULATIONS = 4  # per batch
STEPS = 100  # maximum number of control steps of a random episode
SHOWN = 20  # contexts whose first frames are rendered


@dataclass(frozen=True)
class Episode:
    """A random episode of n simulations: the task's results at every control step, (n, K + 1, ...).

    `goal_error` is empty if the task does not define it.
    """

    qpos: np.ndarray
    time: np.ndarray
    observe: np.ndarray
    observe_expert: np.ndarray
    expert_reward: np.ndarray
    distance: np.ndarray
    goal_error: np.ndarray


class Probe:
    """A task under test, with cached contexts, episodes and frames."""

    def __init__(self, task: Task, seed: int):
        self.task, self.seed = task, seed
        self._pool: RenderPool | None = None

    def rng(self, name: str) -> np.random.Generator:
        return generator(self.seed, f"check-task {name}")

    def broken(self, member: str, problem: str) -> TaskError:
        return broken(self.task, member, problem)

    def draw(self, n: int, name: str = "paper", vary: str = "", seed: int = 0) -> Contexts:
        """Draw `n` contexts from the distribution `name`."""
        return self.task.draw_contexts(generator(self.seed, "check-task", seed), n, distribution(name, vary))

    @cached_property
    def contexts(self) -> Contexts:
        return self.draw(SIMULATIONS)

    @cached_property
    def start(self) -> tuple[np.ndarray, np.ndarray]:
        return self.task.draw_states(self.rng("start"), self.contexts)

    @cached_property
    def actions(self) -> np.ndarray:
        return drawn_actions(self.rng("actions"), self.task, SIMULATIONS)

    @cached_property
    def episode(self) -> Episode:
        return self.play()

    @cached_property
    def has_goal_error(self) -> bool:
        """Whether the task defines goal_error."""
        try:
            self.task.goal_error(BatchSimulation(self.task, SIMULATIONS).reset(*self.start), self.contexts)
        except TaskError:
            return True
        except UsageError:
            return False
        return True

    def play(self, which: slice = slice(None)) -> Episode:
        """Play the random episode for the simulations `which` only."""
        task, contexts = self.task, take(self.contexts, which)
        act = held(self.actions[:, which], task)
        simulation = BatchSimulation(task, len(self.start[0][which]))
        state = simulation.reset(*(part[which] for part in self.start))
        action = np.zeros_like(state.ctrl)
        rows = [self._said(state, action, contexts)]
        for _ in range(min(task.control_steps, STEPS)):
            action = act(state, contexts)
            state = simulation.step(action)
            rows.append(self._said(state, action, contexts))
        said = {name: np.stack([row[name] for row in rows], axis=1) for name in rows[0]}
        said.setdefault("goal_error", np.empty(0))
        return Episode(**said)

    def _said(self, state: State, action: np.ndarray, contexts: Contexts) -> dict[str, np.ndarray]:
        task = self.task
        said = {
            "qpos": state.qpos,
            "time": state.time,
            "observe": task.observe(state),
            "observe_expert": task.observe_expert(state, contexts),
            "expert_reward": task.expert_reward(state, action, contexts),
            "distance": task.distance(state, contexts),
        }
        return said | ({"goal_error": task.goal_error(state, contexts)} if self.has_goal_error else {})

    def roll(self, task: Task, act: Callable[[State, Contexts], np.ndarray]) -> Rollout:
        """Roll out a full episode of `task` from the contexts' initial states."""
        return rollout(task, self.contexts, *task.context_state(self.contexts), act)

    @property
    def pool(self) -> RenderPool:
        from stages.simulation.render import RenderPool

        self._pool = self._pool or RenderPool.of(self.task, 1)
        return self._pool

    def looks(self, contexts: Contexts) -> np.ndarray:
        """First frames (n, H, W, 3), each rendered separately: a frame's tile affects the rounding at its edges."""
        fields, (qpos, _) = self.task.model_fields(contexts), self.task.context_state(contexts)
        cuts = [slice(k, k + 1) for k in range(len(qpos))]
        return np.concatenate([self.pool.render(take(fields, cut), qpos[cut, None])[:, 0] for cut in cuts])

    @cached_property
    def frames(self) -> np.ndarray:
        """First frames (20, H, W, 3) of contexts."""
        return self.looks(self.draw(SHOWN))

    def close(self) -> None:
        if self._pool:
            self._pool.close()
