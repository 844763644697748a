"""The public Python API of ifo, for scripts, notebooks and users' own tasks.

    import ifo

    translation = ifo.translate("runs/reach.translator.h5", context_seed=3)
    demos = ifo.read_artifact("runs/reach.demos.h5", "demos")
    policy = ifo.load_policy("runs/reach-c0.policy.h5")

Everything else, in the packages `stages` and `artifacts`, is internal and may change. Submodules: `ifo.scene` (parts
of tasks), `ifo.envs` (Gymnasium) and `ifo.suite` (dm_control).

Names are loaded on first use, so `import ifo` takes no time. Functions that may import mujoco choose its OpenGL backend
first, because mujoco reads MUJOCO_GL when it is imported.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from artifacts import Artifact, ArtifactError, IfoError, PlatformError, UsageError, read_artifact
    from ifo import envs, scene, suite
    from ifo.api import (
        TranslationReward,
        TranslationRewardVector,
        check_task,
        load_policy,
        make_environment,
        make_task,
        verify,
    )
    from ifo.pipeline import (
        collect_demos,
        evaluate,
        import_demos,
        learn_policy,
        train_expert,
        train_translator,
        translate,
    )
    from stages.runtime.run import StageResult
    from stages.simulation.blame import TaskError
    from stages.simulation.contexts import ContextDistribution, Contexts
    from stages.simulation.task import State, Task

    __version__: str

_MODULE_OF = {
    name: module
    for module, names in {
        "artifacts": ("Artifact", "ArtifactError", "IfoError", "PlatformError", "UsageError", "read_artifact"),
        "ifo.api": (
            "TranslationReward",
            "TranslationRewardVector",
            "__version__",
            "check_task",
            "load_policy",
            "make_environment",
            "make_task",
            "verify",
        ),
        "ifo.pipeline": (
            "collect_demos",
            "evaluate",
            "import_demos",
            "learn_policy",
            "train_expert",
            "train_translator",
            "translate",
        ),
        "stages.runtime.run": ("StageResult",),
        "stages.simulation.blame": ("TaskError",),
        "stages.simulation.contexts": ("ContextDistribution", "Contexts"),
        "stages.simulation.task": ("State", "Task"),
    }.items()
    for name in names
}
_SUBMODULES = ("envs", "scene", "suite")

__all__ = [
    "Artifact",
    "ArtifactError",
    "ContextDistribution",
    "Contexts",
    "IfoError",
    "PlatformError",
    "StageResult",
    "State",
    "Task",
    "TaskError",
    "TranslationReward",
    "TranslationRewardVector",
    "UsageError",
    "__version__",
    "check_task",
    "collect_demos",
    "envs",
    "evaluate",
    "import_demos",
    "learn_policy",
    "load_policy",
    "make_environment",
    "make_task",
    "read_artifact",
    "scene",
    "suite",
    "train_expert",
    "train_translator",
    "translate",
    "verify",
]


def __getattr__(name: str) -> Any:
    if name in _SUBMODULES:
        return importlib.import_module(f"ifo.{name}")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'ifo' has no attribute {name!r}")
    value = getattr(importlib.import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
