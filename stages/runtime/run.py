"""Options of a run that are common to all stages, and the result of a stage."""

from __future__ import annotations

import dataclasses
import os
import platform
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from stages.config.common import check_device
from stages.config.fields import Config
from stages.config.presets import DEFAULT_PRESET, changed
from stages.runtime.processes import Processes
from stages.runtime.progress import Progress


@dataclass(frozen=True)
class RunOptions:
    """How to run a stage.

    Attributes:
        preset: Name of the preset that set the options which were not given; recorded for later stages.
        seed: The run's only seed.
        device: `auto`, `cpu`, `cuda` or `cuda:N`.
        workers: Number of threads and render processes; 0: one per core.
        out: Path of the artifact; None: `runs/NAME.KIND.h5`.
        resume: Continue from the checkpoint next to `out`, if there is one.
        overwrite: Replace a finished artifact at `out`, even if it is exactly what the stage would make.
        command: The command line, for the artifact's lineage.
        progress: Receiver of progress and messages.
        processes: The processes that share the run.
        given: Names of the options that the user gave; None: the options whose values come from no preset and no
            built-in task.
    """

    preset: str = DEFAULT_PRESET
    seed: int = 0
    device: str = "auto"
    workers: int = 0
    out: Path | None = None
    resume: bool = False
    overwrite: bool = False
    command: str = "ifo"
    progress: Progress = field(default_factory=Progress)
    processes: Processes = field(default_factory=Processes)
    given: frozenset[str] | None = None


@dataclass(frozen=True)
class StageResult:
    """Result of a stage, which can be used in place of a path.

    Attributes:
        path: Path of the artifact.
        summary: The stage's figures, as `--json` prints them.
    """

    path: Path
    summary: dict[str, Any]

    def __fspath__(self) -> str:
        return os.fspath(self.path)


def check(stage: str, config: Config, run: RunOptions) -> None:
    """Refuse contradictory options of a stage, and given options that have no effect.

    Raises:
        UsageError: One line that names the option and what to do.
    """
    check_device(run.device)
    config.validate(changed(stage, config) if run.given is None else run.given)


def full_config(stage: str, config: Any, run: RunOptions, **extra: Any) -> dict[str, Any]:
    """Return the complete configuration of a run as JSON-ready values, as stored in the artifact."""
    values = {key: list(value) if isinstance(value, tuple) else value for key, value in vars_of(config).items()}
    return {"stage": stage, "preset": run.preset, **extra, **values}


def vars_of(config: Any) -> dict[str, Any]:
    """Return the fields of a configuration dataclass and their values."""
    return {item.name: getattr(config, item.name) for item in dataclasses.fields(config)}


def environment(device: str = "cpu") -> dict[str, str]:
    """Return versions and devices that may affect a result."""
    versions = {name: metadata.version(name) for name in ("torch", "mujoco", "numpy", "stable-baselines3")}
    return {"python": platform.python_version(), "gl": os.environ.get("MUJOCO_GL", ""), "device": device, **versions}
