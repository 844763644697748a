"""dm_control interface: the same tasks, contexts and frames as the batch simulation, one simulation at a time.

Importing this module loads GL: call `stages.simulation.gl.choose_backend` first.

    env = suite.load("reach", contexts="paper", seed=0)
    time_step = env.reset()
    frame = suite.frame(env.physics, env.task.task)
"""

from __future__ import annotations

import copy
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
from dm_control import mujoco
from dm_control.mujoco import wrapper
from dm_control.rl import control
from dm_control.suite import base

from artifacts.errors import UsageError
from stages.runtime.seeding import generator
from stages.simulation.contexts import DISTRIBUTIONS, ContextDistribution, Contexts
from stages.simulation.gl import check_not_forked
from stages.simulation.registry import distribution, make_task
from stages.simulation.render import reduced
from stages.simulation.task import State, Task

DrawContexts = Callable[[np.random.Generator, int], Contexts]

OBSERVERS = ("learner", "expert")


class Physics(mujoco.Physics):
    """Physics of one simulation of a task."""

    def task_state(self) -> State:
        """The state in the form that tasks use, with leading axis 1; its arrays are copies."""
        return State(
            qpos=np.array(self.data.qpos)[None],
            qvel=np.array(self.data.qvel)[None],
            site_xpos=np.array(self.data.site_xpos)[None],
            time=np.array([self.data.time]),
            ctrl=np.array(self.data.ctrl)[None],
        )

    def render(self, *args: Any, **kwargs: Any) -> np.ndarray:
        """Render a camera's view, as `dm_control.mujoco.Physics.render` does."""
        self._make_current()
        return super().render(*args, **kwargs)

    def free_rendering(self) -> None:
        """Free the GL context, which is created again if another frame is rendered."""
        if self._contexts:
            self._make_current()
            self._free_rendering_contexts()

    def free(self) -> None:
        """Free the GL context and the simulation. Calling it twice is allowed."""
        self.free_rendering()
        super().free()

    def _make_current(self) -> None:
        """Make the GL context current even if dm_control believes that it is, because others may have replaced it."""
        check_not_forked()
        gl = self.contexts.gl
        with gl.make_current() as thread:
            thread.call(gl._platform_make_current)


class Environment(control.Environment):
    """dm_control's environment. Call `close` before the interpreter exits, to free the GL context."""

    def close(self) -> None:
        self.physics.free()


class SuiteTask(base.Task):
    """A `stages.simulation.task.Task` as a dm_control task.

    Attributes:
        task: The task.
        contexts: The current episode's context, with leading axis 1.
    """

    def __init__(
        self,
        task: Task,
        contexts: str | ContextDistribution | DrawContexts = "paper",
        seed: int | None = None,
        random: np.random.RandomState | int | None = None,
        observe: str = "learner",
        pixels: bool = False,
    ):
        """Create the task.

        Args:
            contexts: A distribution, its name, or a function (rng, n) -> contexts.
            seed: If given, episode k is drawn from `seeding.generator(seed, "episode", k)`, as in the batch simulation.
            random: Random state from which episodes are drawn if no seed is given, as elsewhere in dm_control.
            observe: `learner` (positions, velocities and time) or `expert` (also the expert's observation).
            pixels: Whether observations contain frames.

        Raises:
            UsageError: The distribution or observer is unknown.
        """
        super().__init__(random)
        if observe not in OBSERVERS:
            raise UsageError(f"observe={observe!r}: expected one of {', '.join(OBSERVERS)}")
        self.task = task
        self.seed(seed)
        self._draw_contexts = _drawer(task, contexts)
        self._expert = observe == "expert"
        self._pixels = pixels
        self._action = np.zeros((1, task.action_size))
        self._distances: list[np.ndarray] = []
        # dm_control asks for the observations' shapes before the first episode.
        self.contexts = task.draw_contexts(np.random.default_rng(0), 1, DISTRIBUTIONS["fixed"])

    def seed(self, seed: int | None) -> None:
        """Restart at episode 0 of `seed`. With None, episodes are drawn from the random state."""
        self._seed, self._episode = seed, 0

    def _generator(self) -> np.random.Generator:
        if self._seed is None:
            return generator(int(self.random.randint(2**31)), "episode", 0)
        self._episode += 1
        return generator(self._seed, "episode", self._episode - 1)

    def initialize_episode(self, physics: Physics) -> None:
        """Draw a context and an initial state, and write them into the physics."""
        rng = self._generator()
        self.contexts = self._draw_contexts(rng, 1)
        qpos, qvel = self.task.draw_states(rng, self.contexts)
        for name, values in self.task.model_fields(self.contexts).items():
            getattr(physics.model, name)[:] = values[0]
        physics.data.qpos[:], physics.data.qvel[:] = qpos[0], qvel[0]
        physics.data.ctrl[:] = 0.0
        physics.forward()
        self._action[:] = 0.0
        self._distances = [self.task.distance(physics.task_state(), self.contexts)]

    def before_step(self, action: Any, physics: Physics) -> None:
        """Apply `action`, clipped to [-1, 1]."""
        self._action[0] = np.clip(getattr(action, "continuous_actions", action), -1.0, 1.0)
        physics.set_control(self._action[0])

    def after_step(self, physics: Physics) -> None:
        """Record the distance to the goal."""
        self._distances.append(self.task.distance(physics.task_state(), self.contexts))

    def get_observation(self, physics: Physics) -> OrderedDict[str, np.ndarray]:
        """Position, velocity and time; the expert's observation and frames on request."""
        state = physics.task_state()
        observation = OrderedDict(position=state.qpos[0], velocity=state.qvel[0], time=state.time)
        if self._expert:
            observation["expert"] = self.task.observe_expert(state, self.contexts)[0]
        if self._pixels:
            observation["pixels"] = frame(physics, self.task)
        return observation

    def get_reward(self, physics: Physics) -> float:
        """The hand-written reward that experts learn from."""
        return float(self.task.expert_reward(physics.task_state(), self._action, self.contexts)[0])

    def distance(self, physics: Physics) -> float:
        """Distance to the goal, in meters (see `Task.distance`)."""
        return float(self.task.distance(physics.task_state(), self.contexts)[0])

    def normalised_distance(self, physics: Physics) -> float:
        """The paper's metric if the episode ended now: the distance divided by the initial distance."""
        initial, final = self.task.outcome(np.stack(self._distances, axis=1))
        return float(final[0] / initial[0])


def _drawer(task: Task, contexts: str | ContextDistribution | DrawContexts) -> DrawContexts:
    if isinstance(contexts, str):
        contexts = distribution(contexts)
    if isinstance(contexts, ContextDistribution):
        drawn_from = contexts
        return lambda rng, n: task.draw_contexts(rng, n, drawn_from)
    return contexts


def load(
    task_name: str = "reach",
    contexts: str | ContextDistribution | DrawContexts = "paper",
    seed: int | None = None,
    random: np.random.RandomState | int | None = None,
    observe: str = "learner",
    pixels: bool = False,
    environment_kwargs: dict[str, Any] | None = None,
) -> Environment:
    """Create a dm_control environment of the task. Each episode has its own context.

    Args:
        task_name: The task's name.
        contexts, seed, random, observe, pixels: As in `SuiteTask`.
        environment_kwargs: Arguments of `control.Environment`, for example `flat_observation`.

    Raises:
        UsageError: The task, distribution or observer is unknown.
    """
    task = make_task(task_name, typed=True)
    return Environment(
        Physics.from_model(wrapper.MjModel(copy.copy(task.model))),
        SuiteTask(task, contexts, seed, random, observe, pixels),
        # Half a step less than the horizon, so that rounding cannot make an episode one step longer.
        time_limit=(task.control_steps - 0.5) * task.control_timestep,
        n_sub_steps=task.substeps,
        **(environment_kwargs or {}),
    )


def frame(physics: mujoco.Physics, task: Task) -> np.ndarray:
    """The frame (H, W, 3), uint8 RGB, of the task's camera, identical to the batch renderer's."""
    # Without reflections, like the batch renderer: a few scenes of the suite have reflecting floors.
    size = (side * task.oversampling for side in task.frame_size)
    drawn = physics.render(*size, camera_id=task.camera, render_flag_overrides={"reflection": False})
    return reduced(drawn[None], task.oversampling)[0]
