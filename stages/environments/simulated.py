"""The batched simulation of a task as an environment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from stages.environments.protocol import Environment
from stages.environments.timing import Timing
from stages.runtime.seeding import generator
from stages.simulation.batch import BatchSimulation
from stages.simulation.contexts import Contexts
from stages.simulation.task import State, Task

if TYPE_CHECKING:
    from stages.learners.reward import Reward
    from stages.simulation.render import RenderPool


class Camera:
    """Renders the frames of simulations that share one context; its render processes start with it."""

    def __init__(self, task: Task, context: Contexts, pool: RenderPool):
        """Render `task` in `context` (leading axis 1) with `pool`, which is closed with the camera."""
        self.pool = pool
        self._fields = task.model_fields(context)

    def frames(self, state: State) -> np.ndarray:
        """Frames (n, H, W, 3), uint8, of n simulations."""
        return self.pool.render(self._fields, state.qpos[None])[0]

    def close(self) -> None:
        """End the render processes."""
        self.pool.close()


@dataclass(frozen=True)
class SimulatedMoment:
    """The state of n simulations after the same control step.

    Only rewards that are defined by the simulator's state use the state.

    Attributes:
        step: Control steps since the start of the episode.
        state: State of the simulations.
        contexts: Their contexts.
        observation: Observations (n, D).
        camera: Renders the frames; None: the environment has no frames.
    """

    step: int
    state: State
    contexts: Contexts
    observation: np.ndarray
    camera: Camera | None = None

    def frames(self) -> np.ndarray:
        if self.camera is None:
            raise ValueError("the environment was made without a camera")
        return self.camera.frames(self.state)


class SimulatedEnvironment(Environment):
    """`nsim` simulations of a task; contexts and initial states depend only on the seed and the episode number.

    Attributes:
        task: The task.
        distances: Normalized final distances (nsim,) of each batch of episodes that ended since `pop_distances`.
    """

    moment: SimulatedMoment
    last: SimulatedMoment

    def __init__(
        self,
        task: Task,
        nsim: int,
        seed: int,
        contexts: Callable[[np.random.Generator, int], Contexts],
        reward: Reward,
        expert: bool = False,
        nthread: int = 0,
        camera: Camera | None = None,
    ):
        """Simulate `task`.

        Args:
            task: The task.
            nsim: Number of simulations.
            seed: Seed of contexts and initial states.
            contexts: Draws n contexts.
            reward: What the learner is paid.
            expert: Whether the learner observes what the expert does, such as the goal.
            nthread: Threads of the simulation; 0: one per core.
            camera: Renders the frames that the reward sees; None: it sees none.
        """
        self.task = task
        self.distances: list[np.ndarray] = []
        self._seed, self._draw_contexts, self._expert, self._camera = seed, contexts, expert, camera
        self._simulation = BatchSimulation(task, nsim, nthread)
        self._distances: list[np.ndarray] = []
        super().__init__(
            task.name,
            nsim,
            Timing.regular(task.control_steps, task.frame_every),
            reward,
            task.action_size,
            truncates=task.truncates,
        )

    @cached_property
    def has_clock(self) -> bool:  # type: ignore[override]
        return ends_with_clock(self.task, self.moment.state)

    def begin(self) -> SimulatedMoment:
        rng = generator(self._seed, "episode", self.episode)
        contexts = self._draw_contexts(rng, self._simulation.nsim)
        state = self._simulation.reset(*self.task.draw_states(rng, contexts))
        self._distances = [self.task.distance(state, contexts)]
        return self._moment(0, state, contexts)

    def advance(self, actions: np.ndarray) -> SimulatedMoment:
        before = self.moment
        state = self._simulation.step(actions)
        self._distances.append(self.task.distance(state, before.contexts))
        return self._moment(before.step + 1, state, before.contexts)

    def _moment(self, step: int, state: State, contexts: Contexts) -> SimulatedMoment:
        seen = self.task.observe_expert(state, contexts) if self._expert else self.task.observe(state)
        return SimulatedMoment(step, state, contexts, seen, self._camera)

    def record(self) -> None:
        initial, final = self.task.outcome(np.stack(self._distances, axis=1))
        self.distances.append(final / initial)

    def pop_figures(self) -> dict[str, float]:
        ended = self.pop_distances()
        success = (ended < self.task.success_threshold).mean()
        return {"normalised_distance": float(ended.mean()), "success": float(success)}

    def pop_distances(self) -> np.ndarray:
        """Normalized final distances (m,) of all episodes that ended since the last call."""
        ended = np.concatenate(self.distances) if self.distances else np.empty(0)
        self.distances = []
        return ended

    def close(self) -> None:
        super().close()
        if self._camera is not None:
            self._camera.close()


def ends_with_clock(task: Task, state: State) -> bool:
    """Whether the last entry of the learner's observation, and no other, is time relative to the episode length."""
    start, end = (task.observe(replace(state, time=np.full_like(state.time, t))) for t in (0.0, task.horizon))
    told = (end - start).astype(np.float64)
    return bool(np.allclose(told[:, :-1], 0, atol=1e-6) and np.allclose(told[:, -1], 1, atol=1e-5))
