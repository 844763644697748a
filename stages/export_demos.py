"""export-demos: write demonstrations as a dataset of another library. Only frames and times are exported."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from artifacts import (
    Artifact,
    ArtifactError,
    UsageError,
    atomic_folder,
    atomic_path,
    read_artifact,
    sha256_of,
    sibling,
    stem_of,
)
from artifacts.interrupts import deferred_interrupts
from stages.config.demonstrations import MOST_FPS, ExportConfig
from stages.config.names import CAMERA, PLAIN_FPS
from stages.datasets.export import Export
from stages.runtime.run import RunOptions, StageResult, check

AT_A_TIME = 64  # demonstrations in memory at a time
FILE_SUFFIXES = (".hdf5", ".h5")
MINARI_NAME = re.compile(r"[-\w]+-v\d+")


def export_demos(demos: Path, config: ExportConfig, run: RunOptions) -> StageResult:
    """Write demonstrations in `config.format`, completely or not at all. Existing files are never replaced.

    Contexts and distances are not exported: they serve audits only, and real videos do not have them.

    Args:
        demos: The demos artifact.
        config: The format and its options.
        run: Its `out` is the output path. There is no seed because nothing is random.

    Raises:
        ArtifactError: The demonstrations cannot be read, or the format does not support their shape.
        UsageError: The options are inconsistent, or the output exists.
        PlatformError: A library that writes the format is not installed, or the disk is full.
    """
    check("export-demos", config, run)
    artifact = read_artifact(demos, "demos")
    out = _free(run.out, demos, config.format)
    count, length, height, width, _ = artifact.describe()["frames"][0]
    if config.video and (height % 2 or width % 2):
        raise ArtifactError(f"{demos}: H.264 needs even sides, but frames are {width}x{height} pixels: omit --video")
    if length < 2:
        raise ArtifactError(f"{demos}: its videos have {length} frame: expected at least 2")
    fps = config.fps or _fps(artifact)
    with deferred_interrupts() as check_interrupt:
        export = Export(
            shape=(count, length, height, width),
            videos=lambda: _videos(artifact, count, length, fps, run, check_interrupt),
            camera=config.camera or CAMERA,
            task=_text(config.task or str(artifact.manifest.config.get("task") or "") or "what the videos show"),
            fps=fps,
            video=config.video,
            crf=config.crf,
            origin={
                "from": _text(run.command),
                "demos": _text(demos.name),
                "demos_sha256": sha256_of(demos),
                **({"dataset_id": _minari_name(out)} if config.format == "minari" else {}),
            },
        )
        _write(out, config.format, export)
    for line in _remarks(config, export):
        run.progress.say(line)
    return StageResult(out, {"demos": count, "frames": count * length, "fps": fps, "bytes": _size(out)})


def _write(out: Path, name: str, export: Export) -> None:
    from stages.datasets.hdf5_writing import write_minari, write_robomimic
    from stages.datasets.lerobot_writing import write_lerobot

    if name == "robomimic":
        with atomic_path(out) as temporary:
            write_robomimic(temporary, export)
        return
    with atomic_folder(out) as temporary:
        (write_lerobot if name == "lerobot" else write_minari)(temporary, export)


def _videos(
    artifact: Artifact, count: int, length: int, fps: int, run: RunOptions, check_interrupt: Callable[[], None]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield frames (T, H, W, 3) and times (T,) of all demonstrations, checking for interrupts before each."""
    with run.progress.bar("export-demos", count, "demos") as bar:
        for start in range(0, count, AT_A_TIME):
            part = slice(start, start + AT_A_TIME)
            frames = artifact.read("frames", part)
            plain = np.broadcast_to(np.arange(length) / fps, frames.shape[:2])
            times = artifact.read("times", part) if "times" in artifact else plain
            for video in zip(frames, times.astype(float), strict=True):
                check_interrupt()
                yield video
            bar.update(min(start + AT_A_TIME, count))


def _free(out: Path | None, demos: Path, name: str) -> Path:
    """The output path, which must not exist yet."""
    stem = stem_of(demos)
    default = {"lerobot": f"{stem}.lerobot", "robomimic": f"{stem}.robomimic.hdf5", "minari": f"{stem}-v0"}[name]
    out = out or sibling(demos, "").with_name(default)
    if (name == "robomimic") != (out.suffix in FILE_SUFFIXES):
        wanted = f"a file name ending in {FILE_SUFFIXES[0]}" if name == "robomimic" else "the name of a folder"
        raise UsageError(f"--out {out}: expected {wanted}")
    if os.path.lexists(out):  # Unlike Path.exists, it never raises.
        raise UsageError(f"{out}: already exists: remove it, or choose another name with --out")
    return out


def _fps(artifact: Artifact) -> int:
    """Frames per second according to the demonstrations' times, rounded."""
    if "times" not in artifact:
        return PLAIN_FPS
    times = artifact["times"]
    lasting = float(np.median(times[:, -1] - times[:, 0]))
    rate = (times.shape[1] - 1) / lasting if lasting > 0 else PLAIN_FPS
    return min(max(round(rate), 1), MOST_FPS)


def _minari_name(out: Path) -> str:
    """The name under which Minari loads the dataset, derived from its folder."""
    return out.name if MINARI_NAME.fullmatch(out.name) else re.sub(r"[^-\w]", "-", out.name) + "-v0"


def _remarks(config: ExportConfig, export: Export) -> Iterator[str]:
    yield f"exported {export.shape[0]} demonstrations at {export.fps} frames per second, without actions"
    if config.video:
        yield f"the video compression is lossy (H.264, 4:2:0, crf {export.crf}); omit --video to keep the exact frames"


def _text(words: str) -> str:
    # Escape what UTF-8 cannot encode, so that it stays readable.
    return words.encode("utf-8", "backslashreplace").decode("utf-8")


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in (path, *path.rglob("*")) if file.is_file())
