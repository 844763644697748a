"""Functions of the public API. Import them from `ifo`, which re-exports them."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from artifacts.version import ifo_version

if TYPE_CHECKING:
    import gymnasium

    from artifacts import VerifyReport
    from stages.learners.policy import Policy
    from stages.simulation.checking import Report
    from stages.simulation.task import Task

__version__ = ifo_version()
# Classes of rewards, loaded on first use, and their modules.
REWARDS = {
    "TranslationReward": "stages.rewards.gym_wrapper",
    "TranslationRewardVector": "stages.rewards.gym_vector",
}


def verify(path: str | Path) -> VerifyReport:
    """Read an artifact completely, check every dataset, and check that its parents exist and are unchanged.

    Raises:
        ArtifactError: The first problem, in one line.
    """
    from artifacts import verify_artifact

    return verify_artifact(path)


def make_task(name: str) -> Task:
    """Return the task called `name`: a built-in task, `dm:DOMAIN-TASK`, a plug-in's task, or `MODULE:ATTR`.

    The function chooses the OpenGL backend if mujoco has not been imported yet.

    Raises:
        UsageError: There is no such task.
        TaskError: The task is a user's own and is broken.
    """
    _choose_backend(required=False)
    from stages.simulation.registry import make_task

    return make_task(name, typed=True)


def check_task(task: Task, seed: int = 0) -> Report:
    """Check a task against every requirement of the stages, as `ifo check-task` does.

    Returns:
        A report with `problems` (one line each; empty if there are none), the names of the requirements that were
        checked (`promises`), and `frames` (20, H, W, 3), uint8, the first frames of 20 contexts.

    Raises:
        PlatformError: No OpenGL backend works on this machine.
    """
    _choose_backend()
    from stages.simulation.checking import check_task

    return check_task(task, seed)


def make_environment(path: str | Path) -> gymnasium.Env:
    """Make the Gymnasium environment of a `translation` or `policy` artifact as `ifo learn-policy` does.

    Every episode starts in the learner's context and has the artifact's number of steps; an environment that ends
    earlier stands still until then. The observation is flat, without images, and its last entry is the time, from 0 to
    1. Actions are scaled to [-1, 1]. `render` returns frames of the translator's size. After the last step,
    `info["outcome"]` has the return of the environment's own reward (`env_return`) and, if it is known, `success`.

        env = ifo.TranslationReward(ifo.make_environment(path), path)

    Raises:
        ArtifactError: The file is missing, damaged, of the wrong kind, or was not made for a Gymnasium environment.
        UsageError: The environment cannot be made, fails, or is code that IFO_ENVS does not permit.
    """
    _choose_backend(required=False)
    from artifacts import ArtifactError, read_artifact
    from stages.environments.lockstep import Strict
    from stages.environments.making import make_environment
    from stages.environments.spec import EnvironmentSpec

    source = read_artifact(path, ("translation", "policy"))
    spec = EnvironmentSpec.of(source)
    if spec is None:
        raise ArtifactError(f"{path}: was not made for a Gymnasium environment: use ifo.make_task or ifo.envs")
    return Strict(make_environment(spec), spec, range(0))


def load_policy(path: str | Path) -> Policy:
    """Load the policy from a `policy` or `expert` artifact.

    Its method `act(observation, noise=None)` maps observations (n, D) of n simulations to actions (n, nu) in [-1, 1]:
    the mean action, or a sample if `noise` is a `torch.Generator`. A learner's policy observes `Task.observe(state)`,
    an expert's policy `Task.observe_expert(state, contexts)`. In a dm_control environment of `ifo.suite`:

        env = ifo.suite.load("reach")
        observation = env.task.task.observe(env.physics.task_state())  # (1, D)
        time_step = env.step(policy.act(observation)[0])

    Raises:
        ArtifactError: The file is missing, damaged, or of the wrong kind.
    """
    from artifacts import read_artifact
    from stages.learners.policy import Policy

    return Policy.load(read_artifact(path, ("policy", "expert")))


def _choose_backend(required: bool = True) -> None:
    from stages.simulation.gl import choose_backend

    choose_backend(required)


def __getattr__(name: str) -> Any:
    if name not in REWARDS:
        raise AttributeError(f"module 'ifo.api' has no attribute {name!r}")
    _choose_backend(required=False)  # They make the translation's task, which imports mujoco.
    return getattr(importlib.import_module(REWARDS[name]), name)
