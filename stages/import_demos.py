"""import-demos: import real videos as demonstrations: frames only, without contexts, expert or distances."""

from __future__ import annotations

import dataclasses
import os
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import closing
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import (
    ArtifactError,
    PlatformError,
    UsageError,
    default_path,
    sha256_of,
    sibling,
    write_overview,
    write_png,
)
from artifacts.interrupts import deferred_interrupts
from stages.config.demonstrations import Crop, ImportConfig, parse_crop, parse_size
from stages.config.presets import DEFAULT_PRESET
from stages.datasets.finding import find_episodes
from stages.footage.crops import centred_crop, check_crop, read_crops, reduced
from stages.footage.footage import Footage
from stages.footage.moments import Segment, choose_frames
from stages.footage.preview import preview_cell, preview_sheet
from stages.footage.sources import Source, find_videos
from stages.runtime.outputs import Output
from stages.runtime.run import RunOptions, StageResult, check, environment, full_config
from stages.translation.loop import FEWEST

PREVIEWED = 200  # maximum number of videos in a preview
NAMED = 3  # videos that a note lists by name
REASONS = 100  # different reasons for skipping a video that are printed


@dataclasses.dataclass(frozen=True)
class Taken:
    """The part taken from a video: frames (T, H, W, 3), times (T,) in seconds, and the record for the artifact."""

    frames: np.ndarray
    times: np.ndarray
    record: dict[str, Any]


class Importer:
    """Imports videos, skips unusable ones, and collects remarks about the others."""

    def __init__(self, config: ImportConfig, run: RunOptions) -> None:
        self._config, self._run = config, run
        self.size = parse_size(config.size)
        self.segment = Segment(config.frames, config.start, config.end, config.fps)
        self._crop = parse_crop(config.crop) if config.crop else None
        self._crops: dict[Path, Crop] = {}
        self.skipped: list[dict[str, str]] = []
        self.reasons: dict[str, list[str]] = defaultdict(list)
        self.notes: dict[str, list[str]] = defaultdict(list)
        self._digests: dict[str, str] = {}

    def find(self, paths: Sequence[Path]) -> list[Source]:
        """Find the videos at or in these paths, each once, and read their crops if there is a crop file.

        Raises:
            UsageError: --camera is missing for a dataset with several cameras, or is given without any dataset.
        """
        found: dict[tuple[str, str], Source] = {}
        for path in paths:
            try:
                for source in find_episodes(path, self._config.camera) or find_videos(path):
                    found.setdefault((os.path.realpath(source.path), source.part), source)
            except ArtifactError as error:
                self._skip(str(path), error)
        sources = list(found.values())
        if self._config.camera and sources and not any(source.camera for source in sources):
            raise UsageError(f"--camera {self._config.camera}: only datasets have named cameras: omit the option")
        if self._config.crop_file and sources:
            crops, unknown = read_crops(Path(self._config.crop_file), sources)
            self._crops = {source.path: crop for source, crop in zip(sources, crops, strict=True)}
            if unknown:
                self._run.progress.say(f"{self._config.crop_file} has rows that match no video: {_some(unknown)}")
        return sources

    def inputs(self, sources: Sequence[Source]) -> dict[str, Any]:
        """The inputs of the import, for its recipe: names and digests of the videos, and the digest of the crop file.

        The digest of an unreadable file is empty.
        """
        for source in sources:
            try:
                self._digests[source.label] = source.sha256()
            except (ArtifactError, OSError):
                self._digests[source.label] = ""
        crops = self._config.crop_file
        return {
            "inputs": [[_name(label), digest] for label, digest in self._digests.items()],
            "crops": sha256_of(crops) if crops else "",
        }

    def take(self, source: Source) -> Taken | None:
        """Take the selected frames of a video; None if the video cannot be used.

        Raises:
            ArtifactError: The video cannot be used, and --strict is set.
        """
        try:
            footage = source.open()
            indices, behind = choose_frames(footage, self.segment)
            different, places = np.unique(indices, return_inverse=True)
            frames = np.empty((len(different), *self.size, 3), np.uint8)
            times = np.empty(len(different))
            with closing(footage.pictures(different)) as pictures:
                for k, (times[k], picture) in enumerate(pictures):
                    if k == 0:
                        shape, crop = picture.shape[:2], self._crop_of(source, picture)
                    elif picture.shape[:2] != shape:
                        raise ArtifactError(f"{source.label}: image size changes midway: convert it to one size")
                    frames[k] = reduced(picture, crop, self.size)
            if footage.damage and self._config.strict:
                raise ArtifactError(
                    f"{source.label}: {footage.damage}: replace the file, or choose another segment with --start and "
                    "--end"
                )
            record = {
                "name": _name(source.label),
                **({"camera": source.camera} if source.camera else {}),
                "sha256": self._digests.get(source.label) or source.sha256(),
                "size": list(shape[::-1]),
                "duration": round(footage.duration, 6),
                "rotation": footage.rotation,
                "crop": list(crop),
            }
        except ArtifactError as error:
            self._skip(source.label, error)
            return None
        self._note(source, footage, crop, len(indices) - len(different), behind)
        return Taken(frames[places], times[places], record)

    def preview(self, source: Source) -> np.ndarray | None:
        """The first selected frame with the crop drawn on it; None if the video cannot be used."""
        try:
            footage = source.open()
            indices, _ = choose_frames(footage, self.segment)
            with closing(footage.pictures(indices[:1])) as pictures:
                _, picture = next(pictures)
            crop = self._chosen_crop(source, picture)
            try:
                check_crop(crop, picture.shape[:2], source.label)
            except ArtifactError as error:  # The preview is meant to show where a bad crop is.
                self._run.progress.warn(str(error))
            return preview_cell(picture, crop, f"{source.path.name} {source.part}".rstrip())
        except ArtifactError as error:
            self._skip(source.label, error)
            return None

    def _chosen_crop(self, source: Source, picture: np.ndarray) -> Crop:
        return self._crop or self._crops.get(source.path) or centred_crop(picture.shape[:2], self.size)

    def _crop_of(self, source: Source, picture: np.ndarray) -> Crop:
        crop = self._chosen_crop(source, picture)
        check_crop(crop, picture.shape[:2], source.label)
        return crop

    def _skip(self, label: str, error: ArtifactError) -> None:
        if self._config.strict:
            raise ArtifactError(f"{error} (--strict: nothing was written)") from error
        # A fault in a dataset file affects every episode in it.
        if str(error) not in self.reasons and len(self.reasons) < REASONS:
            self._run.progress.warn(f"skipped {error}")
        self.reasons[str(error)].append(label)
        self.skipped.append({"name": _name(label), "reason": str(error)})

    def _note(self, source: Source, footage: Footage, crop: Crop, repeated: int, behind: int) -> None:
        name = source.label
        if behind:
            self.notes["short videos repeat their last frame"].append(name)
        elif repeated:
            self.notes["segments with fewer than --frames frames repeat some of them"].append(name)
        if crop.h < self.size[0] or crop.w < self.size[1]:
            self.notes[f"crops smaller than {self._config.size} pixels are enlarged"].append(name)
        if abs(crop.h * self.size[1] - crop.w * self.size[0]) > max(self.size):
            self.notes[f"crops whose aspect ratio differs from {self._config.size} are distorted"].append(name)
        if footage.cut:
            self.notes["truncated or damaged, but complete in the selected segment"].append(name)
        if footage.damage:
            self._run.progress.warn(f"{source.label}: {footage.damage} (--strict: refuse it)")
        for note in footage.notes:
            self.notes[note].append(name)


def import_demos(paths: Sequence[Path], config: ImportConfig, run: RunOptions, preview: bool = False) -> StageResult:
    """Take `config.frames` frames of each video and write the `demos` artifact, a contact sheet and an MP4.

    Videos that cannot be used are skipped with a one-line message each. Frames are decoded, cropped and resized one at
    a time, so that memory use does not grow with the length of the videos.

    Args:
        paths: Videos, folders of videos, folders of images, and datasets, where each episode is a video.
        config: The segment, the crop and the size to take.
        run: Preset and output. There is no seed because nothing is random.
        preview: Write only a sheet of the first frames with the crops drawn on them.

    Raises:
        ArtifactError: No video can be used or, with `config.strict`, one cannot. Nothing is written.
        UsageError: The options are inconsistent, or the output would replace a video.
    """
    check("import-demos", config, run)
    importer = Importer(config, run)
    out = run.out or default_path(Path("runs"), _stem(config, run), "demos")
    sources = importer.find(paths)
    _check_not_an_input(out, sources)
    if preview:
        return _write_preview(importer, sources, out, run)
    output = Output.of(out, "demos", "import-demos", config, run, extra=importer.inputs(sources))
    if kept := output.kept():
        return kept
    _compare_with_task(config, importer.size, run)
    height, width = importer.size
    videos = _room_for((len(sources), config.frames, height, width, 3))
    times: list[np.ndarray] = []
    records: list[dict[str, Any]] = []
    at_once = not all(source.part for source in sources)
    with (
        run.progress.bar("import-demos", len(sources), "videos") as bar,
        deferred_interrupts(at_once) as check_interrupt,
    ):
        for done, source in enumerate(sources, 1):
            check_interrupt()
            taken = importer.take(source)
            if taken is not None:
                videos[len(times)] = taken.frames
                times.append(taken.times)
                records.append(taken.record)
            bar.update(done)
    _check_some(len(times), importer)
    for line in _remarks(importer, records):
        run.progress.say(line)
    videos = videos[: len(times)]
    summary = {"demos": len(times), "skipped": importer.skipped, "frames": len(times) * config.frames}
    pictures = write_overview(out, videos)
    return output.write(
        {"frames": videos, "times": np.stack(times)},
        config=full_config("import-demos", config, run, videos=records, skipped=importer.skipped),
        summary=summary | pictures,
        environment=environment() | {name: metadata.version(name) for name in ("av", "opencv-python-headless")},
    )


def _room_for(shape: tuple[int, ...]) -> np.ndarray:
    try:
        return np.empty(shape, np.uint8)
    except (MemoryError, ValueError) as error:  # NumPy raises ValueError for more than an address can be.
        raise PlatformError(
            f"{shape[0]} videos of {shape[1]} frames do not fit in memory: import fewer, or choose a smaller --size"
        ) from error


def _compare_with_task(config: ImportConfig, size: tuple[int, int], run: RunOptions) -> None:
    """Warn if the learner's own videos have another shape, before a translator is trained on the wrong one."""
    if not config.task:
        return
    from stages.simulation.gl import choose_backend
    from stages.simulation.registry import make_task

    choose_backend(required=False)
    task = make_task(config.task, typed=True)
    if (config.frames, *size) != (task.frames, *task.frame_size):
        height, width = task.frame_size
        run.progress.say(
            f"{task.name} has {task.frames} frames of {width}x{height} pixels: ifo translate can use these "
            "demonstrations only with --context-image"
        )


def _stem(config: ImportConfig, run: RunOptions) -> str:
    """Stem of the output's name. It differs from the task's name, which collect-demos uses."""
    from stages.simulation.registry import file_name

    task = f"-{file_name(config.task)}" if config.task else ""
    return f"imported{task}" + ("" if run.preset == DEFAULT_PRESET else f"-{run.preset}")


def _check_not_an_input(out: Path, sources: Sequence[Source]) -> None:
    """Refuse an output that would replace one of the imported files."""
    written = {os.path.realpath(sibling(out, suffix)) for suffix in (".mp4", ".png", ".preview.png")}
    written.add(os.path.realpath(out))
    for file in {file: None for source in sources for file in source.files}:
        if os.path.realpath(file) in written:
            raise UsageError(f"--out {out} would replace {file}, which is imported: choose another name")


def _check_some(usable: int, importer: Importer) -> None:
    if not usable:
        raise ArtifactError(f"none of the {len(importer.skipped)} videos can be used: nothing was written")


def _write_preview(importer: Importer, sources: Sequence[Source], out: Path, run: RunOptions) -> StageResult:
    cells: list[np.ndarray] = []
    for source in sources[:PREVIEWED]:
        cell = importer.preview(source)
        if cell is not None:
            cells.append(cell)
    _check_some(len(cells), importer)
    if len(sources) > PREVIEWED:
        run.progress.say(f"the preview shows the first {PREVIEWED} of {len(sources)} videos")
    path = write_png(sibling(out, ".preview.png"), preview_sheet(cells))
    return StageResult(path, {"videos": len(cells), "skipped": importer.skipped})


def _remarks(importer: Importer, records: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield lines about what was imported."""
    for note, names in importer.notes.items():
        yield f"{note} ({len(names)} of {len(records)} videos: {_some(names)})"
    if len(importer.reasons) > REASONS:
        yield f"skipped more videos for {len(importer.reasons) - REASONS} other reasons, which the artifact lists"
    for names in list(importer.reasons.values())[:REASONS]:
        if len(names) > 1:
            yield f"skipped {len(names) - 1} more for the same reason as {names[0]}"
    same: dict[str, list[str]] = defaultdict(list)
    for record in records:
        same[record["sha256"]].append(record["name"])
    for names in same.values():
        if len(names) > 1:
            yield f"the same video was imported {len(names)} times: {_some(names)}"
    counted = f", skipped {len(importer.skipped)}" if importer.skipped else ""
    yield f"imported {len(records)} videos{counted}"
    if len(records) < FEWEST:
        yield f"train-translator needs at least {FEWEST} demonstrations: import more videos"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")


def _name(label: str) -> str:
    # Escape a file name that UTF-8 cannot encode, so that it stays readable.
    return label.encode("utf-8", "backslashreplace").decode("utf-8")
