"""Functions of the public API, which `ifo` re-exports: import them from there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from artifacts.version import ifo_version

if TYPE_CHECKING:
    from artifacts import VerifyReport
    from stages.learners.policy import Policy
    from stages.simulation.checking import Report
    from stages.simulation.task import Task

__version__ = ifo_version()


def verify(path: str | Path) -> VerifyReport:
    """Read an artifact whole, and check every dataset and that its parents are there and unchanged.

    Raises:
        ArtifactError: The first problem, in one line.
    """
    from artifacts import verify_artifact

    return verify_artifact(path)


def make_task(name: str) -> Task:
    """The task called `name`: a built-in one, `dm:DOMAIN-TASK`, one of a plug-in, or `MODULE:ATTR`.

    Chooses the OpenGL backend where mujoco is not imported yet.

    Raises:
        UsageError: There is no such task.
        TaskError: It is a user's, and broken.
    """
    _choose_backend(required=False)
    from stages.simulation.registry import make_task

    return make_task(name, typed=True)


def check_task(task: Task, seed: int = 0) -> Report:
    """Hold a task to everything that the stages rely on, as `ifo check-task` does.

    Returns:
        A report with `problems` (one line each; empty if there are none), the names of the `promises` that were
        checked, and `frames` (20, H, W, 3), uint8, the first frames of 20 contexts.

    Raises:
        PlatformError: No OpenGL backend works here.
    """
    _choose_backend()
    from stages.simulation.checking import check_task

    return check_task(task, seed)


def load_policy(path: str | Path) -> Policy:
    """The policy in a `policy` or `expert` artifact.

    Its method `act(observation, noise=None)` maps observations (n, D) of n simulations to actions (n, nu) in [-1, 1]:
    the mean action, or with `noise`, a `torch.Generator`, a sample. A learner's policy takes `Task.observe(state)`, an
    expert's `Task.observe_expert(state, contexts)`. In a dm_control environment of `ifo.suite`:

        env = ifo.suite.load("reach")
        observation = env.task.task.observe(env.physics.task_state())  # (1, D)
        time_step = env.step(policy.act(observation)[0])

    Raises:
        ArtifactError: The file is missing, damaged, or of another kind.
    """
    from artifacts import read_artifact
    from stages.learners.policy import Policy

    return Policy.load(read_artifact(path, ("policy", "expert")))


def _choose_backend(required: bool = True) -> None:
    from stages.simulation.gl import choose_backend

    choose_backend(required)


def __getattr__(name: str) -> Any:
    if name != "TranslationReward":
        raise AttributeError(f"module 'ifo.api' has no attribute {name!r}")
    _choose_backend(required=False)  # It makes the translation's task, which imports mujoco.
    from stages.rewards.gym_wrapper import TranslationReward

    return TranslationReward
