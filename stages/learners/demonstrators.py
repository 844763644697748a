"""Who demonstrates: an expert that was trained on the robot, or the person that a task brings, with its own body."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from artifacts import Artifact, ArtifactError, UsageError, read_artifact
from stages.config.presets import defaults
from stages.simulation.contexts import Contexts
from stages.simulation.task import State, Task

if TYPE_CHECKING:
    from stages.simulation.render import RenderPool

Act = Callable[[State, Contexts], np.ndarray]

IMPORTED = "import-demos"  # the stage of demonstrations that hold only frames


class Demonstrator(ABC):
    """Does a task in any context.

    Attributes:
        task: What is filmed: the learner's task, or the same with another body in place of the robot.
        parents: Artifacts that it was made from.
        noise: Standard deviation of actions that spoil the task: torques of an expert, but places of a hand.
    """

    task: Task
    parents: tuple[Artifact, ...] = ()
    noise = 1.0

    @abstractmethod
    def begin(self, contexts: Contexts, rng: np.random.Generator | None = None) -> Act:
        """The actions of an episode in each of n contexts: (state, contexts) -> (n, nu).

        Args:
            rng: Of what varies from one demonstration to the next beside the context; None: nothing.
        """

    @abstractmethod
    def kinesthetic(self, contexts: Contexts) -> np.ndarray:
        """Joint positions (T, nq) of the robot that is led through the task in one context (leading axis 1)."""

    def motion(self, contexts: Contexts) -> np.ndarray:
        """Joint positions (n, T, nq) at a video's frames, of what it does in each of n contexts."""
        from stages.simulation.batch import rollout

        episodes = rollout(self.task, contexts, *self.task.context_state(contexts), self.begin(contexts), 1)
        return episodes.frame_qpos(self.task)

    def video(self, contexts: Contexts, pool: RenderPool) -> np.ndarray:
        """The same as video (n, T, H, W, 3): the truth to judge translations by. `pool` draws `task`."""
        return pool.render(self.task.model_fields(contexts), self.motion(contexts))


class Expert(Demonstrator):
    """A trained policy that sees the state and the goal."""

    def __init__(self, task: Task, path: Path):
        """Load the expert artifact at `path`.

        Raises:
            ArtifactError: It is no expert of this task.
        """
        from stages.learners.policy import Policy

        artifact = load_expert(path, task.name)
        self.task, self.parents = task, (artifact,)
        self._policy = Policy.load(artifact)

    def begin(self, contexts: Contexts, rng: np.random.Generator | None = None) -> Act:
        return lambda state, where: self._policy.act(self.task.observe_expert(state, where))

    def kinesthetic(self, contexts: Contexts) -> np.ndarray:
        return self.motion(contexts)[0]


class Person(Demonstrator):
    """Moves by a plan, which knows of the context."""

    noise = 0.1

    def __init__(self, task: Task):
        """The person that `task` brings."""
        if task.demonstrator is None:
            raise UsageError(f"task {task.name} brings nobody who demonstrates it: an expert must be trained")
        self._robot, self.task = task, task.demonstrator

    def begin(self, contexts: Contexts, rng: np.random.Generator | None = None) -> Act:
        plan = self.task.plan(contexts, rng)

        def act(state: State, where: Contexts) -> np.ndarray:
            step = round(float(state.time[0]) / self.task.control_timestep)
            return plan[min(step, len(plan) - 1)]

        return act

    def kinesthetic(self, contexts: Contexts) -> np.ndarray:
        return self._robot.kinesthetic(contexts)


def demonstrator_of(task: Task, demos: Artifact) -> Demonstrator:
    """Who made the demonstrations.

    Raises:
        ArtifactError: The expert's file is missing, changed or unknown.
    """
    if task.demonstrator is not None:
        return Person(task)
    return Expert(task, demos.parent("expert", check=True).path)


def load_expert(path: str | Path, task_name: str) -> Artifact:
    """The expert artifact at `path`, of task `task_name`.

    Raises:
        ArtifactError: No expert of that task.
    """
    artifact = read_artifact(path, "expert")
    if artifact.config["task"] != task_name:
        raise ArtifactError(f"{path} is an expert of {artifact.config['task']}, expected one of {task_name}")
    return artifact


def filmed_contexts(demos: Artifact) -> tuple[str, str]:
    """The context distribution of demonstrations, and what varies in it (empty: the task's own choice).

    Imported demonstrations do not record one: theirs is what `collect-demos` would draw from under their preset.
    """
    if demos.config.get("stage") == IMPORTED:
        from stages.simulation.registry import task_defaults

        task = demos.config.get("task") or ""
        return defaults(demos.config["preset"], "collect-demos", task, own=task_defaults(task)).contexts, ""
    return demos.config["contexts"], demos.config.get("vary", "")
