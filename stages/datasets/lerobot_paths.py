"""Where a LeRobotDataset stores its files, and what its table of episodes says about an episode."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from glob import escape
from pathlib import Path

from artifacts import ArtifactError
from stages.datasets.episode import brief, is_plain
from stages.footage.sources import natural_order

INFO = "meta/info.json"
EPISODES = "meta/episodes"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
INDICES = ("chunk_index", "file_index")
MOST_PARTS = 32  # of a path
LONGEST = 1024  # characters of a path
FIELD = re.compile(r"\{(\w+)(?::0?(\d{1,2})d)?\}")


@dataclass(frozen=True)
class Listed:
    """An episode as the table of episodes describes it.

    Attributes:
        label: The name used in messages.
        number: Its index.
        table: Its data table; None if not recorded.
        video: Its video file; None if not recorded or if images are stored in tables.
        begin: Time of its first frame in the video, seconds; NaN if not recorded.
        end: Time of the first frame after it.
        length: Number of frames; 0 if not recorded.
        span: Number of rows according to dataset_from_index and dataset_to_index; 0 if not recorded.
    """

    label: str
    number: int
    table: Path | None
    video: Path | None
    begin: float
    end: float
    length: int
    span: int

    @property
    def most_rows(self) -> int:
        """The larger number of rows that it states."""
        return max(self.length, self.span)


@dataclass(frozen=True)
class Template:
    """A path with fields in braces. It avoids str.format, which is unsafe on untrusted templates.

    Attributes:
        root: The dataset's folder.
        text: The path relative to the folder.
        camera: Value of the field `video_key`.
    """

    root: Path
    text: str
    camera: str

    def at(self, chunk_index: int, file_index: int) -> Path:
        """The file with these indices.

        Raises:
            ArtifactError: The path has unknown fields, or leads out of the dataset.
        """
        return self.root / self._filled(dict(zip(INDICES, (chunk_index, file_index), strict=True)))

    def files(self) -> list[Path]:
        """All files that the template fits, in natural order.

        Raises:
            ArtifactError: The path has unknown fields, or leads out of the dataset, or a folder cannot be read.
        """
        pattern = Template(self.root, escape(self.text), escape(self.camera))._filled(dict.fromkeys(INDICES, "*"))
        try:
            found = [file for file in self.root.glob(str(pattern)) if file.is_file()]
        except OSError as error:
            raise ArtifactError(
                f"{self.root}: cannot be searched for {brief(self.text)} ({error.strerror}): check its permissions"
            ) from error
        return sorted(found, key=lambda file: [natural_order(Path(part)) for part in file.relative_to(self.root).parts])

    def _filled(self, indices: Mapping[str, int | str]) -> Path:
        values: dict[str, int | str] = {"video_key": self.camera, **indices}
        problem = f"{self.root / INFO}: has the path {brief(repr(self.text))}: expected a path like {DATA_PATH}"

        def fill(match: re.Match[str]) -> str:
            if match[1] not in values:
                raise ArtifactError(problem)
            value = values[match[1]]
            return str(value).zfill(int(match[2] or 0)) if isinstance(value, int) else str(value)

        relative = Path(FIELD.sub(fill, self.text))
        unsafe = "{" in str(relative) or relative.is_absolute() or ".." in relative.parts
        usual = 0 < len(relative.parts) <= MOST_PARTS and len(str(relative)) <= LONGEST
        if unsafe or not usual or not all(is_plain(part) for part in relative.parts):
            raise ArtifactError(problem)
        return relative
