"""What every stage is told beside its own configuration, and what it answers."""

from __future__ import annotations

import dataclasses
import platform
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from artifacts import PlatformError, UsageError
from stages.processes import Processes
from stages.progress import Progress

MAX_WORKERS_A_CORE = 4


@dataclass(frozen=True)
class RunOptions:
    """How to run a stage.

    Attributes:
        preset: Name of the preset that open options came from; recorded for the stages downstream.
        seed: The run's only seed.
        device: `auto`, `cpu`, `cuda` or `cuda:N`.
        workers: Threads and render processes; 0: one a core.
        out: Path of the artifact; None: `runs/NAME.KIND.h5`.
        resume: Continue from the checkpoint beside `out` where there is one.
        command: The command line, for the artifact's lineage.
        progress: Where progress and messages go.
        processes: The processes that share the run.
    """

    preset: str = "quick"
    seed: int = 0
    device: str = "auto"
    workers: int = 0
    out: Path | None = None
    resume: bool = False
    command: str = "ifo"
    progress: Progress = field(default_factory=Progress)
    processes: Processes = field(default_factory=Processes)


@dataclass(frozen=True)
class StageResult:
    """What a stage wrote: the artifact's path, and figures for `--json` and for people."""

    path: Path
    summary: dict[str, Any]


def full_config(stage: str, config: Any, run: RunOptions, **extra: Any) -> dict[str, Any]:
    """The whole configuration of a run as JSON-ready values, as the artifact keeps it."""
    values = {key: list(value) if isinstance(value, tuple) else value for key, value in vars_of(config).items()}
    return {"stage": stage, "preset": run.preset, **extra, **values}


def vars_of(config: Any) -> dict[str, Any]:
    """The fields of a configuration dataclass."""
    return {item.name: getattr(config, item.name) for item in dataclasses.fields(config)}


def environment(device: str = "cpu") -> dict[str, str]:
    """Versions and devices that a result may depend on."""
    import os

    versions = {name: metadata.version(name) for name in ("torch", "mujoco", "numpy", "stable-baselines3")}
    return {"python": platform.python_version(), "gl": os.environ.get("MUJOCO_GL", ""), "device": device, **versions}


def pick_device(device: str) -> str:
    """The torch device to use; `auto` is CUDA where there is one.

    Raises:
        PlatformError: The device asked for is not there.
        UsageError: There is no such kind of device.
    """
    import torch

    if device == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cpu":
        return device
    if not device.startswith("cuda"):
        raise UsageError(f"--device {device}: expected auto, cpu, cuda or cuda:N")
    index = int(device.partition(":")[2] or 0) if device.partition(":")[2].isdigit() or device == "cuda" else -1
    if index < 0:
        raise UsageError(f"--device {device}: expected auto, cpu, cuda or cuda:N")
    if not torch.cuda.is_available() or index >= torch.cuda.device_count():
        raise PlatformError(f"--device {device}: torch sees no such CUDA device here; use --device cpu")
    return device


def pick_workers(workers: int) -> int:
    """Threads and render processes to use.

    Raises:
        UsageError: Far more than there are cores.
    """
    import os

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if workers > MAX_WORKERS_A_CORE * cores:
        raise UsageError(f"--workers {workers}: expected at most {MAX_WORKERS_A_CORE * cores} on {cores} cores")
    return workers or cores
