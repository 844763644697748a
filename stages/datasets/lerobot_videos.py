"""Where the episodes of a LeRobotDataset lie in its video files. The frames decide, not the table of episodes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from pathlib import Path
from typing import NamedTuple

from artifacts import ArtifactError
from stages.datasets.episode import check_is_there
from stages.datasets.lerobot_paths import EPISODES, Listed, Template
from stages.datasets.lerobot_tables import OTHER_LENGTH, Tables
from stages.datasets.window import VideoWindow, between, nearest, period_of, slack
from stages.footage.video import VideoFile

OTHER_TIMES = f"time stamps in {EPISODES} disagree with the videos; episodes are found by counting frames"
OTHER_VIDEO = f"{EPISODES} names another video file than the one with the frames; episodes are found by counting frames"


class Place(NamedTuple):
    """Where an episode lies: its file, the index of its first frame, and its number of frames."""

    file: Path
    first: int
    length: int


class Videos:
    """The video files of a camera.

    The time stamps of an episode are only a first guess, because they drift in datasets that were merged, converted or
    edited. If the lengths of the episodes in a file add up to its number of frames, the episodes are found by counting;
    the same holds for all files together. Otherwise, time stamps are used unless they contradict the lengths.
    """

    def __init__(self, template: Template, episodes: Sequence[Listed], tables: Tables) -> None:
        """Args:
        template: Path of the files.
        episodes: All episodes of the dataset, in order of their numbers.
        tables: The data tables, which contain the lengths of episodes as well.
        """
        self._template, self._tables, self._episodes = template, tables, episodes
        self._inside: dict[Path, list[Listed]] = defaultdict(list)
        for one in episodes:
            if one.video is not None:
                self._inside[one.video].append(one)
        self._opened: VideoFile | None = None
        self._found: dict[Path | None, Mapping[int, Place]] = {}  # Per file, or None for all files together.
        self._rows: dict[int, int] = {}

    def window(self, one: Listed, notes: Sequence[str]) -> VideoWindow:
        """The frames of an episode.

        Raises:
            ArtifactError: Its file cannot be read, or it is unclear which frames belong to it.
        """
        if one.video is None:
            raise ArtifactError(f"{one.label}: {EPISODES} does not record where its {self._template.camera} is stored")
        problem: ArtifactError | None = None
        try:
            place = self._counted(one.video).get(one.number)
        except ArtifactError as error:
            place, problem = None, error
        place = place or self._counted_together().get(one.number)
        if place is not None:
            video = self._open(place.file)
            if not place.length:
                raise ArtifactError(f"{one.label}: has no frames")
            said = [OTHER_LENGTH] * (one.length not in (0, place.length))
            if place.file != one.video:
                said.append(OTHER_VIDEO)
            elif (nearest(video, one.begin), nearest(video, one.end)) != (place.first, place.first + place.length):
                said.append(OTHER_TIMES)
            return VideoWindow(one.label, video, place.first, place.length, [*notes, *said])
        if problem is not None:
            raise problem
        video = self._open(one.video)
        self._check_times(one, video)
        return between(one.label, video, one.begin, one.end, self._length(one), notes)

    def _open(self, path: Path) -> VideoFile:
        """The video file. The last one is cached because consecutive episodes share a file."""
        if self._opened is None or self._opened.path != path:
            check_is_there(path)
            self._opened = VideoFile(path)
        return self._opened

    def _counted(self, file: Path) -> Mapping[int, Place]:
        """The places of the episodes of a file; empty if their lengths do not add up, or their order is unclear."""
        if file not in self._found:
            video, inside = self._open(file), self._inside[file]
            self._found[file] = {}
            by_time = sorted(inside, key=lambda one: (one.begin, one.number))
            for episodes in (inside, by_time):
                firsts = [0, *accumulate(one.length for one in episodes)]
                if firsts[-1] == len(video.times) and _agree(video, episodes, firsts):
                    self._found[file] = _places(file, episodes, firsts, [one.length for one in episodes])
                    return self._found[file]
            by_time_nearly = self._nearly_agree(video, by_time) and not _in_order(inside)
            order = by_time if by_time_nearly else inside
            self._found[file] = self._fill([file], [len(video.times)], order, period_of(video))
        return self._found[file]

    def _counted_together(self) -> Mapping[int, Place]:
        """The places of all episodes; empty unless they fill all files, one after the other."""
        if None not in self._found:
            self._found[None] = {}
            files = self._template.files()
            try:
                videos = [self._open(file) for file in files]
            except ArtifactError:  # A damaged file is reported when its own episodes are opened.
                return self._found[None]
            if len(files) > 1:
                counts = [len(video.times) for video in videos]
                self._found[None] = self._fill(files, counts, self._episodes, period_of(videos[0]))
        return self._found[None]

    def _fill(
        self, files: Sequence[Path], counts: Sequence[int], episodes: Sequence[Listed], period: float
    ) -> Mapping[int, Place]:
        """Place episodes one after the other into files with these numbers of frames; empty if they do not fill them.

        Their lengths are those of the tables. Without these, `length` is used if the time stamps confirm it.
        """
        stated = [one.length for one in episodes]
        confirmed = all(abs((one.end - one.begin) / (period or 1) - one.length) < 1 for one in episodes)
        for lengths in ([self._rows_of(one) for one in episodes], stated if confirmed else []):
            ends = list(accumulate(counts))
            firsts = [0, *accumulate(lengths)]
            if lengths and firsts[-1] == ends[-1] and set(ends) <= set(firsts):
                found: dict[int, Place] = {}
                for file, begin, end in zip(files, [0, *ends], ends, strict=False):
                    inside = [k for k, first in enumerate(firsts[:-1]) if begin <= first < end]
                    for k in inside:
                        found[episodes[k].number] = Place(file, firsts[k] - begin, lengths[k])
                return found
        return {}

    def _check_times(self, one: Listed, video: VideoFile) -> None:
        """Raise ArtifactError if the time stamps of an episode contradict the lengths of the episodes before it.

        Episodes whose time stamps follow one another without a gap must do so in frames as well.
        """
        inside = sorted(self._inside[video.path], key=lambda other: other.begin)
        first = nearest(video, inside[0].begin)
        for before, other in pairwise(inside):
            free, first = first + self._length(before), nearest(video, other.begin)
            follows = abs(nearest(video, before.end) - first) < 1
            contradicts = first < free or (follows and first > free)
            if contradicts and other.number == one.number:
                raise ArtifactError(
                    f"{one.label}: its time stamps contradict the lengths of the episodes before it in {video.label}: "
                    "its tables are damaged; download the dataset again"
                )
            first = free if contradicts else first

    def _nearly_agree(self, video: VideoFile, episodes: Sequence[Listed]) -> bool:
        """Whether the time stamps of episodes in this order are at most a few frames off."""
        firsts = accumulate((self._length(one) for one in episodes), initial=0)
        return all(
            abs(nearest(video, one.begin) - first) <= slack(first) for one, first in zip(episodes, firsts, strict=False)
        )

    def _length(self, one: Listed) -> int:
        return self._rows_of(one) or one.length

    def _rows_of(self, one: Listed) -> int:
        """Number of the rows of an episode; 0 if they are unknown."""
        if one.number not in self._rows:
            try:
                self._rows[one.number] = len(self._tables.rows_of(one))
            except ArtifactError:
                self._rows[one.number] = 0
        return self._rows[one.number]


def _agree(video: VideoFile, episodes: Sequence[Listed], firsts: Sequence[int]) -> bool:
    """Whether the time stamps of episodes agree with their first frames and ends."""
    stamps = [(nearest(video, one.begin), nearest(video, one.end)) for one in episodes]
    return stamps == list(pairwise(firsts))


def _in_order(episodes: Sequence[Listed]) -> bool:
    """Whether no time stamps contradict that episodes are in order of their numbers."""
    return not any(before.begin > after.begin for before, after in pairwise(episodes))


def _places(
    file: Path, episodes: Sequence[Listed], firsts: Sequence[int], lengths: Sequence[int]
) -> Mapping[int, Place]:
    return {one.number: Place(file, first, n) for one, first, n in zip(episodes, firsts, lengths, strict=False)}
