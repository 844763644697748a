"""Options that several commands share: where a run's output goes, and how it runs. Light imports only."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from artifacts.errors import UsageError
from stages.config.fields import Config, option
from stages.config.presets import DEFAULT_PRESET, PRESETS

KNOWN_PRESETS = tuple(PRESETS)
DEVICES = "auto, cpu, cuda or cuda:N"
# Options that a file of options may set beside a stage's own, and that --show-config shows.
SETTINGS = ("preset", "seed", "device", "workers")


@dataclass(frozen=True)
class CommonOptions(Config):
    """Options that stages share; each command has those of them that it names."""

    preset: str = option(
        DEFAULT_PRESET, f"Defaults of all options: the parent's preset, else {DEFAULT_PRESET}.", KNOWN_PRESETS
    )
    seed: int = option(0, "The run's only seed: the parent's, else 0.", low=0)
    device: str = option("auto", "auto (CUDA where there is one), cpu, cuda or cuda:N.", metavar="DEVICE")
    workers: int = option(0, "Threads and render processes (0: one per core).", low=0)
    out: Path | None = option(None, "Artifact to write, ending in .h5 (default: runs/NAME.KIND.h5).", metavar="PATH")
    overwrite: bool = option(
        False,
        "Replace a finished artifact at --out (default: keep it if it is the same, else stop).",
        names=("--overwrite",),
    )
    resume: bool = option(False, "Continue from the checkpoint beside --out.", names=("--resume",))
    config: Path | None = option(
        None,
        "Read options from this file, as --show-config prints them; the command line wins. One file may hold the "
        "tables of all stages.",
        metavar="TOML",
        names=("--config",),
    )
    show_config: bool = option(
        False, "Print what every option resolves to, as TOML, and do nothing else.", names=("--show-config",)
    )
    json: bool = option(False, "Print one JSON object with figures instead of the path.", names=("--json",))
    quiet: bool = option(False, "No progress on standard error.", names=("--quiet", "-q"))


@dataclass(frozen=True)
class CollectOptions(CommonOptions):
    """Of collect-demos."""

    expert: Path | None = option(None, "Expert to record (default: one of the same preset is trained).", metavar="PATH")


@dataclass(frozen=True)
class ImportOptions(CommonOptions):
    """Of import-demos."""

    preset: str = option(DEFAULT_PRESET, "Preset of the stages that follow.", KNOWN_PRESETS, show=True)
    out: Path | None = option(
        None,
        "Artifact to write, ending in .h5 (default: runs/imported.demos.h5, or runs/imported-TASK.demos.h5).",
        metavar="PATH",
    )
    preview: bool = option(
        False, "Write only a PNG of the first frames with the crops drawn on them.", names=("--preview",)
    )


@dataclass(frozen=True)
class ExportOptions(CommonOptions):
    """Of export-demos."""

    out: Path | None = option(
        None,
        "Folder to write, for robomimic a file; it must not exist yet (default: beside the artifact, NAME.lerobot, "
        "NAME.robomimic.hdf5 or NAME-v0).",
        metavar="PATH",
    )


@dataclass(frozen=True)
class LookOptions(CommonOptions):
    """Of the commands that look at things."""

    json: bool = option(False, "Print one JSON object.", names=("--json",))


@dataclass(frozen=True)
class CheckOptions(LookOptions):
    """Of check-task."""

    seed: int = option(0, "Seed of everything that is drawn.", low=0, show=True)
    out: Path | None = option(None, "Contact sheet to write (default: runs/TASK.check.png).", metavar="PATH")


@dataclass(frozen=True)
class ReportOptions(CommonOptions):
    """Of report."""

    out: Path = option(Path("runs/report.html"), "Page to write, ending in .html.", metavar="PATH", show=True)


@dataclass(frozen=True)
class ReproduceOptions(CommonOptions):
    """Of reproduce."""

    preset: str = option(DEFAULT_PRESET, "Preset of every stage.", KNOWN_PRESETS, show=True)
    seed: int = option(0, "Seed of every stage.", low=0, show=True)
    out: Path = option(Path("runs/reproduce"), "Folder of all files.", metavar="FOLDER", show=True)
    dry_run: bool = option(
        False, "Print the jobs that would run, and an estimate of their minutes.", names=("--dry-run",)
    )


def check_device(device: str) -> None:
    """Refuse what is no device's name; whether there is such a device is seen when it is used.

    Raises:
        UsageError: It is none.
    """
    if not re.fullmatch(r"auto|cpu|cuda(:\d{1,3})?", device, re.ASCII):
        raise UsageError(f"--device {device}: expected {DEVICES}")
