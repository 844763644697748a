"""Where the episodes of a LeRobotDataset lie in its video files. The frames decide, not the table of episodes."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from artifacts import ArtifactError
from stages.datasets.episode import check_is_there
from stages.datasets.lerobot_paths import EPISODES, Listed, Template
from stages.datasets.lerobot_tables import OTHER_LENGTH, Tables
from stages.datasets.window import LEAST, VideoWindow, between, nearest, period_of
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
    edited. If the lengths of the episodes in a file add up to its number of frames, the episodes are found by counting:
    first by the lengths in the tables, then by those in the table of episodes. The same holds for all files together.
    Otherwise, time stamps are used unless they contradict the lengths.
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
        self._unclear: dict[Path, ArtifactError] = {}
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
        """The places of the episodes of a file; empty if no lengths add up to its frames.

        Raises:
            ArtifactError: The file cannot be read, or lengths add up but contradict the time stamps.
        """
        if file in self._unclear:
            raise self._unclear[file]
        if file not in self._found:
            try:
                self._found[file] = self._count(self._open(file), self._inside[file])
            except ArtifactError as error:
                self._unclear[file] = error
                raise
        return self._found[file]

    def _count(self, video: VideoFile, inside: Sequence[Listed]) -> Mapping[int, Place]:
        frames, stated = len(video.times), {one.number: one.length for one in inside}
        by_time = sorted(inside, key=lambda one: (one.begin, one.number)) if _have_times(inside) else inside
        for order in (inside, by_time):  # Usually, everything agrees.
            if sum(stated.values()) == frames and _confirmed(video, order, stated) == 2 * len(order):
                return _places(video, order, stated)
        rows = {one.number: self._rows_of(one) for one in inside}
        lasting = {one.number: nearest(video, one.end) - nearest(video, one.begin) for one in inside}
        tiled = sum(lasting.values()) == frames and _confirmed(video, by_time, lasting) == 2 * len(by_time)
        if sum(rows.values()) == frames:
            by_rows = _better(video, inside, by_time, rows)
            if by_rows is not None:
                return _places(video, by_rows, rows)
        elif sum(stated.values()) != frames:
            denied = any(rows[number] not in (0, length) for number, length in lasting.items())
            return _places(video, by_time, lasting) if tiled and not denied else {}
        elif not tiled:
            as_stated = _better(video, inside, by_time, stated)
            if as_stated is not None and _each_confirmed(video, as_stated, stated):
                return _places(video, as_stated, stated)
        raise ArtifactError(
            f"{video.label}: its time stamps and lengths in {EPISODES} contradict each other: its tables are damaged; "
            "download the dataset again"
        )

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
                counts, period = [len(video.times) for video in videos], period_of(videos[0]) or 1.0
                lasting = [abs((one.end - one.begin) / period - one.length) for one in self._episodes]
                stated = {one.number: one.length for one in self._episodes if max(lasting) < 1}
                rows = {one.number: self._rows_of(one) for one in self._episodes}
                candidates = (self._tables.lengths(), rows, stated)
                self._found[None] = next(filter(None, (_fill(files, counts, each) for each in candidates)), {})
        return self._found[None]

    def _check_times(self, one: Listed, video: VideoFile) -> None:
        """Raise ArtifactError if the time stamps of an episode contradict the lengths of the episodes around it.

        Episodes must not overlap. If their time stamps follow one another without the gap that a deleted episode
        leaves, their frames must do so, too.
        """
        before: Listed | None = None
        free = end = 0
        for other in sorted(self._inside[video.path], key=lambda other: other.begin):
            first = nearest(video, other.begin)
            overlaps, follows = first < free, abs(first - end) <= LEAST
            if (overlaps and one in (before, other)) or (follows and first != free and one == other):
                raise ArtifactError(
                    f"{one.label}: its time stamps contradict the lengths of the episodes around it in {video.label}: "
                    "its tables are damaged; download the dataset again"
                )
            first, before, end = free if follows else first, other, nearest(video, other.end)
            free = first + (self._length(other) or end - nearest(video, other.begin))

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


def _fill(files: Sequence[Path], counts: Sequence[int], lengths: Mapping[int, int]) -> Mapping[int, Place]:
    """Place episodes in order of their numbers into files of so many frames; empty if they do not fill them."""
    ends, firsts = list(accumulate(counts)), dict(_firsts(sorted(lengths), lengths))
    if sum(lengths.values()) != ends[-1] or not {0, *ends[:-1]} <= {*firsts.values()}:
        return {}
    found: dict[int, Place] = {}
    for file, begin, end in zip(files, [0, *ends], ends, strict=False):
        inside = [number for number, first in firsts.items() if begin <= first < end]
        found |= {number: Place(file, firsts[number] - begin, lengths[number]) for number in inside}
    return found


def _have_times(episodes: Sequence[Listed]) -> bool:
    return not any(math.isnan(one.begin) for one in episodes)


def _firsts(numbers: Sequence[int], lengths: Mapping[int, int]) -> Iterator[tuple[int, int]]:
    """The number and the first frame of each episode, in this order."""
    return zip(numbers, accumulate((lengths[number] for number in numbers), initial=0), strict=False)


def _confirmed(video: VideoFile, episodes: Sequence[Listed], lengths: Mapping[int, int]) -> int:
    """How many time stamps of episodes in this order agree with these lengths."""
    firsts = dict(_firsts([one.number for one in episodes], lengths))
    begins = sum(nearest(video, one.begin) == firsts[one.number] for one in episodes)
    return begins + sum(nearest(video, one.end) == firsts[one.number] + lengths[one.number] for one in episodes)


def _each_confirmed(video: VideoFile, episodes: Sequence[Listed], lengths: Mapping[int, int]) -> bool:
    """Whether of each episode, a time stamp or the duration agrees with its length, in this order."""
    firsts = dict(_firsts([one.number for one in episodes], lengths))
    for one in episodes:
        first, length = firsts[one.number], lengths[one.number]
        begin, end = nearest(video, one.begin), nearest(video, one.end)
        if begin != first and end != first + length and end - begin != length:
            return False
    return True


def _better(
    video: VideoFile, inside: Sequence[Listed], by_time: Sequence[Listed], lengths: Mapping[int, int]
) -> Sequence[Listed] | None:
    """The order that more time stamps agree with; None if it is unclear."""
    difference = _confirmed(video, inside, lengths) - _confirmed(video, by_time, lengths)
    if list(inside) == list(by_time) or difference > 0:
        return inside
    return by_time if difference < 0 else None


def _places(video: VideoFile, episodes: Sequence[Listed], lengths: Mapping[int, int]) -> Mapping[int, Place]:
    firsts = _firsts([one.number for one in episodes], lengths)
    return {number: Place(video.path, first, lengths[number]) for number, first in firsts}
