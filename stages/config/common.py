"""Options that several commands share: output and execution of a run. Light imports only."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from artifacts.errors import UsageError
from stages.config.fields import Config, option
from stages.config.presets import DEFAULT_PRESET, PRESETS

KNOWN_PRESETS = tuple(PRESETS)
DEVICES = "auto, cpu, cuda or cuda:N"
# Options that a file of options may set in addition to a stage's own options. --show-config shows them as well.
SETTINGS = ("preset", "seed", "device", "workers")


@dataclass(frozen=True)
class CommonOptions(Config):
    """Options that stages share; each command lists the ones that it has."""

    preset: str = option(
        DEFAULT_PRESET,
        f"Set of defaults for all other options (default: the parent's preset, else {DEFAULT_PRESET}).",
        KNOWN_PRESETS,
    )
    seed: int = option(0, "Seed of the run (default: the parent's seed, else 0).", low=0)
    device: str = option("auto", "auto (CUDA if available), cpu, cuda or cuda:N.", metavar="DEVICE")
    workers: int = option(0, "Threads and render processes (0: one per core).", low=0)
    out: Path | None = option(None, "Artifact to write, ending in .h5 (default: runs/NAME.KIND.h5).", metavar="PATH")
    overwrite: bool = option(
        False,
        "Make the artifact again and replace an existing one (default: keep it if it is what this command makes, "
        "else stop with an error).",
        names=("--overwrite",),
    )
    resume: bool = option(False, "Continue from the checkpoint next to --out.", names=("--resume",))
    config: Path | None = option(
        None,
        "Read options from this file, in the format of --show-config; options on the command line win. One file may "
        "hold the tables of all stages.",
        metavar="TOML",
        names=("--config",),
    )
    show_config: bool = option(
        False, "Print the value of every option and its origin, as TOML, and exit.", names=("--show-config",)
    )
    json: bool = option(False, "Print one JSON object with figures instead of the path.", names=("--json",))
    quiet: bool = option(False, "Print no progress on standard error.", names=("--quiet", "-q"))


@dataclass(frozen=True)
class CollectOptions(CommonOptions):
    """Shared options of collect-demos."""

    expert: Path | None = option(None, "Expert to record (default: train one with the same preset).", metavar="PATH")


@dataclass(frozen=True)
class TrainOptions(CommonOptions):
    """Shared options of train-translator."""

    base: Path | None = option(
        None,
        "Fine-tune this translator instead of new weights. It may have learned from other tasks and other frame sizes; "
        "--arch is that of the file.",
        metavar="PATH",
        names=("--from",),
    )


@dataclass(frozen=True)
class ImportOptions(CommonOptions):
    """Shared options of import-demos."""

    preset: str = option(DEFAULT_PRESET, "Preset of later stages.", KNOWN_PRESETS, show=True)
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
    """Shared options of export-demos."""

    out: Path | None = option(
        None,
        "Folder to write (robomimic: file); it must not exist yet (default: NAME.lerobot, NAME.robomimic.hdf5 or "
        "NAME-v0, next to the artifact).",
        metavar="PATH",
    )


@dataclass(frozen=True)
class LookOptions(CommonOptions):
    """Options of the commands that only inspect."""

    json: bool = option(False, "Print one JSON object.", names=("--json",))


@dataclass(frozen=True)
class CheckOptions(LookOptions):
    """Options of check-task."""

    seed: int = option(0, "Seed of all random draws.", low=0, show=True)
    out: Path | None = option(None, "Contact sheet to write (default: runs/TASK.check.png).", metavar="PATH")


@dataclass(frozen=True)
class ReportOptions(CommonOptions):
    """Shared options of report."""

    out: Path = option(Path("runs/report.html"), "Page to write, ending in .html.", metavar="PATH", show=True)


@dataclass(frozen=True)
class ViewOptions(CommonOptions):
    """Options of view."""

    out: Path | None = option(
        None, "Page to write, ending in .html (default: NAME.KIND.html, next to the artifact).", metavar="PATH"
    )
    json: bool = option(False, "Print one JSON object instead of the path.", names=("--json",))
    open: bool = option(False, "Open the page in a browser.", names=("--open",))


@dataclass(frozen=True)
class ReproduceOptions(CommonOptions):
    """Shared options of reproduce."""

    preset: str = option(DEFAULT_PRESET, "Preset of every stage.", KNOWN_PRESETS, show=True)
    seed: int = option(0, "Seed of every stage.", low=0, show=True)
    out: Path = option(Path("runs/reproduce"), "Folder for all files.", metavar="FOLDER", show=True)
    dry_run: bool = option(False, "Print the jobs that would run, with their estimated minutes.", names=("--dry-run",))


def check_device(device: str) -> None:
    """Refuse invalid names of devices. Whether the device exists is checked when it is used.

    Raises:
        UsageError: The name is invalid.
    """
    if not re.fullmatch(r"auto|cpu|cuda(:\d{1,3})?", device, re.ASCII):
        raise UsageError(f"--device {device}: expected {DEVICES}")
