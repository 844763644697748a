"""Contexts as files record them; anyone may have written the file."""

from __future__ import annotations

import numpy as np

from artifacts import Artifact, ArtifactError, UsageError
from stages.simulation.contexts import ContextDistribution, Contexts
from stages.simulation.registry import distribution
from stages.simulation.task import Task

LARGEST = 1e30  # no degree, meter or color is as large; distances must not overflow


def recorded_distribution(artifact: Artifact, name: str, vary: str) -> ContextDistribution:
    """The context distribution that a file names.

    Raises:
        ArtifactError: There is no such distribution or factor.
    """
    try:
        return distribution(name, vary)
    except UsageError as error:
        raise ArtifactError(f"{artifact.path}: its configuration has {error}: make the file again") from error


def recorded_contexts(artifact: Artifact, task: Task) -> Contexts:
    """The learner's context (leading axis 1) in a translation or policy.

    Raises:
        ArtifactError: It is not a context of the task.
    """
    config, found = artifact.config, artifact.group("contexts")
    drawn_from = recorded_distribution(artifact, config["contexts"], config.get("vary", ""))
    try:
        task.varied(drawn_from)
    except UsageError as error:
        raise ArtifactError(f"{artifact.path}: its configuration has {error}: make the file again") from error
    for name, values in task.draw_contexts(np.random.default_rng(0), 1, drawn_from).items():
        if name not in found:
            raise ArtifactError(f"{artifact.path}: its context lacks {name}, so it is none of task {task.name}")
        if found[name].shape != values.shape or found[name].dtype.kind != values.dtype.kind:
            raise ArtifactError(
                f"{artifact.path}: contexts/{name} is {found[name].dtype} {found[name].shape}, but in task {task.name} "
                f"it is {values.dtype} {values.shape}: make the file again"
            )
        if values.dtype.kind == "f" and np.abs(found[name]).max(initial=0) > LARGEST:
            raise ArtifactError(f"{artifact.path}: contexts/{name} is out of any range: make the file again")
    return found
