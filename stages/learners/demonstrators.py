"""Demonstrators: a trained expert policy on the robot, or the task's scripted demonstrator with its own body."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from artifacts import Artifact, ArtifactError, UsageError, read_artifact
from stages.config.fields import one_of
from stages.config.presets import PRESETS, defaults
from stages.simulation.contexts import Contexts
from stages.simulation.recorded import recorded_distribution
from stages.simulation.task import State, Task

if TYPE_CHECKING:
    from stages.simulation.render import RenderPool

Act = Callable[[State, Contexts], np.ndarray]

IMPORTED = "import-demos"  # the stage whose demonstrations contain only frames


class Demonstrator(ABC):
    """Base class of demonstrators, which perform a task in any context.

    Attributes:
        task: The task that is recorded: the learner's task, or the same task with another body instead of the robot.
        parents: Artifacts that the demonstrator was made from.
        noise: Standard deviation of action noise that makes the demonstrator fail, in units of its actions: normalized
            torques for an expert, positions for a hand.
    """

    task: Task
    parents: tuple[Artifact, ...] = ()
    noise = 1.0

    @abstractmethod
    def begin(self, contexts: Contexts, rng: np.random.Generator | None = None) -> Act:
        """Start one episode in each of n contexts.

        Args:
            contexts: The n contexts.
            rng: Generator for variation between demonstrations in the same context; None: no variation.

        Returns:
            A function (state, contexts) -> actions (n, nu).
        """

    @abstractmethod
    def kinesthetic(self, contexts: Contexts) -> np.ndarray:
        """Joint positions (T, nq) of the robot, guided through the task in one context (leading axis 1)."""

    def motion(self, contexts: Contexts) -> np.ndarray:
        """Joint positions (n, T, nq) at the video frames of one demonstration in each of n contexts."""
        from stages.simulation.batch import rollout

        episodes = rollout(self.task, contexts, *self.task.context_state(contexts), self.begin(contexts), 1)
        return episodes.frame_qpos(self.task)

    def video(self, contexts: Contexts, pool: RenderPool) -> np.ndarray:
        """Videos (n, T, H, W, 3) of `motion`: the ground truth for translations. `pool` must render `self.task`."""
        return pool.render(self.task.model_fields(contexts), self.motion(contexts))


class Expert(Demonstrator):
    """A trained policy that observes the state and the goal."""

    def __init__(self, task: Task, path: Path):
        """Load the expert artifact at `path`.

        Raises:
            ArtifactError: The file is not an expert for this task.
        """
        from stages.learners.policy import Policy, check_fits, first_observation

        artifact = load_expert(path, task.name)
        check_fits(artifact, task, first_observation(task, expert=True))
        self.task, self.parents = task, (artifact,)
        self._policy = Policy.load(artifact)

    def begin(self, contexts: Contexts, rng: np.random.Generator | None = None) -> Act:
        return lambda state, where: self._policy.act(self.task.observe_expert(state, where))

    def kinesthetic(self, contexts: Contexts) -> np.ndarray:
        return self.motion(contexts)[0]


class Person(Demonstrator):
    """The task's scripted demonstrator, which follows a plan computed from the context."""

    noise = 0.1

    def __init__(self, task: Task):
        """Use the scripted demonstrator of `task`.

        Raises:
            UsageError: The task has no scripted demonstrator.
        """
        if task.demonstrator is None:
            raise UsageError(f"task {task.name} has no scripted demonstrator; train an expert with `ifo train-expert`")
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
    """The demonstrator that recorded `demos`.

    Raises:
        ArtifactError: The expert's file is missing, was changed, or is not recorded in `demos`.
    """
    if task.demonstrator is not None:
        return Person(task)
    return Expert(task, demos.parent("expert", check=True).path)


def load_expert(path: str | Path, task_name: str) -> Artifact:
    """Read the expert artifact at `path`.

    Raises:
        ArtifactError: The file is not an expert for task `task_name`.
    """
    artifact = read_artifact(path, "expert")
    if artifact.config["task"] != task_name:
        raise ArtifactError(f"{path} is an expert for {artifact.config['task']}, expected one for {task_name}")
    return artifact


def filmed_contexts(demos: Artifact) -> tuple[str, str]:
    """The context distribution of demonstrations, and the factors that vary in it (empty: the task's default).

    Imported demonstrations do not record a distribution. For them, this is the one that `collect-demos` would use with
    the same preset.

    Raises:
        ArtifactError: There is no such distribution or preset.
    """
    if demos.config.get("stage") == IMPORTED:
        from stages.simulation.registry import task_defaults

        task, preset = demos.config.get("task") or "", demos.config["preset"]
        if preset not in PRESETS:
            raise ArtifactError(f"{demos.path}: unknown preset {preset!r}: expected one of {one_of(PRESETS)}")
        return defaults(preset, "collect-demos", task, own=task_defaults(task)).contexts, ""
    contexts, vary = demos.config["contexts"], demos.config.get("vary", "")
    recorded_distribution(demos, contexts, vary)
    return contexts, vary
