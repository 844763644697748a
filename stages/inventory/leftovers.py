"""What stages leave behind: temporary files, checkpoints of finished runs, and pictures whose artifact is gone.

Names decide nothing: a file counts as one of ifo's only if its content looks like it, too.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from artifacts import STAGE_FILES, checkpoint_path, open_regular, sibling
from artifacts.glance import Glance
from artifacts.survey import ENDING, TENSORBOARD
from artifacts.usage import is_used

CHECKPOINT = ".checkpoint.h5"
PICTURES: dict[str, Callable[[bytes], bool]] = {  # suffix -> whether a file begins like that
    ".mp4": lambda head: head[4:8] == b"ftyp",
    ".png": lambda head: head.startswith(b"\x89PNG\r\n\x1a\n"),
}
PREVIEW = ".preview.png"
EVENTS = re.compile(r"events\.out\.tfevents\.\S+")  # what TensorBoard writes into its folder
KINDS_OF_STAGES = {files.writes for files in STAGE_FILES.values()}
HEAD = 16  # bytes


def created(item: Glance) -> datetime:
    """Return when an artifact was made; if its manifest does not say, when the file was changed last."""
    for text in (item.manifest.created, None):
        with suppress(ValueError, OverflowError, OSError):
            when = datetime.fromisoformat(text) if text else datetime.fromtimestamp(item.modified, UTC)
            return (when if when.tzinfo else when.replace(tzinfo=UTC)).astimezone(UTC)
    return datetime.fromtimestamp(0, UTC)


def is_finished(checkpoint: Glance, artifact: Glance | None) -> bool:
    """Return whether the run of a checkpoint is finished: the same stage has written its artifact afterwards.

    A checkpoint that is newer than the artifact is of a run with --overwrite, which can be resumed.
    """
    if artifact is None or not checkpoint.path.name.endswith(CHECKPOINT) or artifact.kind not in KINDS_OF_STAGES:
        return False
    before, after = ((created(item), item.modified) for item in (checkpoint, artifact))
    stages = [item.manifest.config.get("stage") for item in (checkpoint, artifact)]
    return before <= after and stages[0] == stages[1]


def artifact_of(checkpoint: str | Path) -> Path:
    """Return the path of the artifact that a checkpoint belongs to (inverse of `checkpoint_path`)."""
    path = Path(checkpoint)
    return path.with_name(path.name.removesuffix(CHECKPOINT) + ENDING)


def is_temporary(folder: Path) -> bool:
    """Return whether a folder with such a name was left behind by a killed writer, and is not used by a running one."""
    try:
        return set(os.listdir(folder)) <= {"new"} and not is_used(folder)
    except OSError:
        return False


def is_orphan(path: Path) -> bool:
    """Return whether a file or folder belongs to an artifact that is gone, and that no run is about to write."""
    artifact = _owner(path)
    if artifact is None or has_owner(path):
        return False
    # While a stage runs, it uses its TensorBoard folder; its pictures are written last.
    board = sibling(artifact, TENSORBOARD)
    return not (os.path.lexists(board) and is_used(board)) and is_companion(path)


def has_owner(path: Path) -> bool:
    """Return whether there is an artifact, or a checkpoint of one, that a file or folder belongs to by its name."""
    artifact = _owner(path)
    return artifact is not None and any(map(os.path.lexists, (artifact, checkpoint_path(artifact))))


def companions(artifact: Path) -> Iterator[Path]:
    """Yield the pictures and the TensorBoard folder of an artifact named NAME.KIND.h5 that exist."""
    if _owner(sibling(artifact, ".mp4")) is None:
        return
    for suffix in (*PICTURES, PREVIEW, TENSORBOARD):
        if is_companion(path := sibling(artifact, suffix)):
            yield path


def is_companion(path: Path) -> bool:
    """Return whether there is a picture, video or TensorBoard folder at a path, as stages write them."""
    try:
        mode = os.lstat(path).st_mode
        if path.name.endswith(TENSORBOARD):
            return stat.S_ISDIR(mode) and all(map(_is_event_file, os.scandir(path)))
        if not stat.S_ISREG(mode) or path.suffix not in PICTURES:
            return False
        with open_regular(path) as file:
            return PICTURES[path.suffix](file.read(HEAD))
    except OSError:
        return False


def _is_event_file(entry: os.DirEntry[str]) -> bool:
    return entry.is_file(follow_symlinks=False) and EVENTS.fullmatch(entry.name) is not None


def _owner(path: Path) -> Path | None:
    """Return the artifact NAME.KIND.h5 that a file belongs to by its name; None: its name is none of ours."""
    for suffix in (*PICTURES, TENSORBOARD):
        if path.name.endswith(suffix):
            stem = path.name.removesuffix(suffix)
            name, _, kind = stem.rpartition(".")
            return path.with_name(stem + ENDING) if name and kind in KINDS_OF_STAGES else None
    return None
