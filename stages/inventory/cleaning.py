"""What could be removed from folders of artifacts, in an order in which every interruption leaves a consistent state.

Kept, whatever the categories: evaluations and all that they were made from; the inputs of unfinished and of running
stages; what was changed less than an hour ago; what cannot be made again; links, and the files that they lead to; and
everything that is not certainly of ifo. A file elsewhere that was made from one here is not seen.
"""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from artifacts import STAGE_FILES
from artifacts.family import CHANGED, OK, Family
from artifacts.glance import Glance
from artifacts.paths import real, stem_of
from artifacts.survey import Problem, Survey, distinct, survey
from artifacts.usage import is_used
from stages.config.inventory import CLEANED
from stages.inventory.leftovers import artifact_of, companions, is_finished, is_orphan, is_temporary

TEMPORARY, CHECKPOINTS = "temporary", "checkpoint"  # categories that are always removed
ORPHANS, SUPERSEDED, UNUSED = CLEANED
CATEGORIES = (TEMPORARY, CHECKPOINTS, *CLEANED)
RECENT = 3600.0  # seconds; in a pipe, a file that is complete is not yet in use by the next stage
IMPORTED = "import-demos"  # the videos may be gone
EXTERNAL = ("context_image", "demonstrator", "weights")  # options that name files or code outside of the lineage

FileState = tuple[int, int, int, int]  # device, inode, size, modification time


@dataclass(frozen=True)
class Item:
    """A file or folder that could be removed.

    Attributes:
        category: One of `CATEGORIES`.
        reason: Why, in a few words.
        bytes: Its size, with everything in it.
        state: What distinguishes it from one that replaces it.
        after: Paths that must be gone before it is removed: what was made from it.
    """

    path: Path
    category: str
    reason: str
    bytes: int
    state: FileState
    after: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Kept:
    """An artifact that is not removed, and why."""

    path: Path
    kind: str
    bytes: int
    reason: str


@dataclass
class Plan:
    """What could be removed.

    Attributes:
        items: What is removed with the chosen categories, in order.
        others: What the other categories would remove in addition.
        kept: Artifacts that no category removes.
        notes: One line for each thing that the user should know.
    """

    items: list[Item] = field(default_factory=list)
    others: list[Item] = field(default_factory=list)
    kept: list[Kept] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def plan(folders: Sequence[Path], include: Sequence[str] = (), now: float | None = None) -> Plan:
    """Find what could be removed from folders and their subfolders; nothing is changed.

    Args:
        folders: Folders to search. Only what is in one of them counts as made from what is in another.
        include: Categories of `CLEANED` to remove in addition to what is always safe to remove.
        now: The time, in seconds since 1970; None: the present.

    Raises:
        ArtifactError: A folder does not exist or cannot be read.
    """
    now = time.time() if now is None else now
    found = survey(folders)
    family = Family(distinct(found))
    done = Plan()
    finished = _finished(family, found)
    leftovers = [_item(path, TEMPORARY, "left by a killed command") for path in found.temporary if is_temporary(path)]
    leftovers += [_item(one.path, CHECKPOINTS, f"{artifact_of(one.path).name} is finished") for one in finished]
    leftovers += [
        _item(path, ORPHANS, "its artifact is gone")
        for path in (*found.files, *found.tensorboard)
        if is_orphan(path) and not _is_recent(_newest(path), now)
    ]
    blocking = [problem for problem in found.problems if not _is_harmless(problem)]
    for problem in blocking[:1]:
        more = f" (and {len(blocking) - 1} more)" if len(blocking) > 1 else ""
        done.notes.append(
            f"{problem.path}{more} {_was(problem.reason)}; what it was made from is not known, so no artifact is "
            "removed: repair, remove or move it first"
        )
    reasons = _protected(family, found, {item.path for item in finished}, now)
    categories = {} if blocking else _categories(family, reasons, {item.path for item in finished})
    chosen = _closed(family, {path: name for path, name in categories.items() if name in include}, finished)
    possible = _closed(family, categories, finished)
    done.items = [item for item in leftovers if item.category not in CLEANED or item.category in include]
    done.others = [item for item in leftovers if item.category in CLEANED and item.category not in include]
    done.items += _artifact_items(family, chosen)
    done.others += _artifact_items(family, {path: name for path, name in possible.items() if path not in chosen})
    gone = {item.path for item in (*done.items, *done.others)}
    done.kept = [
        Kept(item.path, item.kind, item.bytes, reasons.get(item.path, "" if not blocking else "lineage not known"))
        for item in family.members
        if item.path not in gone
    ]
    return done


def _finished(family: Family, found: Survey) -> list[Glance]:
    """Return the checkpoints whose run is finished."""
    at = {item.path: item for item in family.members if item.path not in found.links}
    return [
        item
        for item in at.values()
        if item.kind == "checkpoint" and is_finished(item, at.get(artifact_of(item.path))) and not _is_running(item)
    ]


def _is_running(checkpoint: Glance) -> bool:
    board = checkpoint.path.with_name(artifact_of(checkpoint.path).name.removesuffix(".h5") + ".tensorboard")
    return os.path.lexists(board) and is_used(board)


def _protected(family: Family, found: Survey, finished: set[Path], now: float) -> dict[Path, str]:
    """Return why artifacts are kept in every category: path -> reason."""
    links = {real(path) for path in found.links}
    own: dict[Path, str] = {}
    for item in family.members:
        if item.path in finished:
            continue
        if item.kind == "evaluation":
            own[item.path] = "evaluation"
        elif item.kind == "checkpoint":
            own[item.path] = "unfinished run"
        elif item.path in found.links or real(item.path) in links:
            own[item.path] = "a symbolic link leads to it"
        elif _is_recent(item.modified, now):
            own[item.path] = "changed less than an hour ago"
        elif is_used(item.path):
            own[item.path] = "in use by a running command"
    reasons: dict[Path, str] = {}
    for item in family.members:
        if item.path in own:
            for path in family.needed([item]):
                reasons.setdefault(path, f"needed by {item.path}")
    return reasons | own


def _categories(family: Family, reasons: dict[Path, str], finished: set[Path]) -> dict[Path, str]:
    """Return the category of each artifact that is not protected and could be made again, or is out of date.

    `reasons` receives why the other artifacts are kept.
    """
    categories: dict[Path, str] = {}
    # What an artifact was made from comes first: the category of its parents is then known.
    for item in reversed(family.descendants_first(family.members)):
        if item.path in reasons or item.path in finished:
            continue
        relations = family.parents(item)
        above = {categories.get(one.found.path) for one in relations if one.found is not None}
        if any(one.state == CHANGED for one in relations) or SUPERSEDED in above:
            categories[item.path] = SUPERSEDED
        elif any(one.state != OK for one in relations):
            reasons[item.path] = "cannot be made again: a file that it was made from is missing or unknown"
        elif not _has_recipe(item):
            reasons[item.path] = "cannot be made again from its command"
        else:
            categories[item.path] = UNUSED
    return categories


def _has_recipe(item: Glance) -> bool:
    """Return whether a command makes an artifact again, given its parents."""
    recipe = item.manifest.recipe
    stage, config = recipe.get("stage"), recipe.get("config", {})
    known = stage in STAGE_FILES and stage != IMPORTED and item.manifest.command.startswith("ifo ")
    return known and not any(config.get(name) for name in EXTERNAL)


def _closed(family: Family, categories: dict[Path, str], finished: Iterable[Glance]) -> dict[Path, str]:
    """Return the artifacts of `categories` that nothing else was made from."""
    leave = {item.path for item in finished}
    others = [item for item in family.members if item.path not in categories and item.path not in leave]
    needed = family.needed(others)
    return {path: name for path, name in categories.items() if path not in needed}


def _artifact_items(family: Family, chosen: dict[Path, str]) -> list[Item]:
    """Return artifacts and the pictures that belong to them, each before what it was made from."""
    ordered = family.descendants_first(item for item in family.members if item.path in chosen)
    made_from: dict[Path, list[Path]] = {}
    for item in family.members:
        for source in family.sources(item):
            made_from.setdefault(source.path, []).append(item.path)
    items = []
    for artifact in ordered:
        category, after = chosen[artifact.path], tuple(sorted(made_from.get(artifact.path, ())))
        reason = _REASONS[category](artifact, family)
        items.append(_item(artifact.path, category, reason, after))
        for path in companions(artifact.path):
            items.append(_item(path, category, f"belongs to {artifact.path.name}", (artifact.path,)))
    return items


def _why_superseded(artifact: Glance, family: Family) -> str:
    changed = [one.path.name for one in family.parents(artifact) if one.state == CHANGED]
    return f"made from an earlier {changed[0]}" if changed else "made from a superseded file"


def _why_unused(artifact: Glance, _: Family) -> str:
    return f"no evaluation was made from it; made again by: {artifact.manifest.command}"


_REASONS: dict[str, Callable[[Glance, Family], str]] = {SUPERSEDED: _why_superseded, UNUSED: _why_unused}


def _item(path: Path, category: str, reason: str, after: tuple[Path, ...] = ()) -> Item:
    return Item(path, category, reason, size_of(path), state_of(path), after)


def state_of(path: Path) -> FileState:
    """Return what distinguishes a file or folder from one that replaces it; links are not followed.

    Of a folder, size and time are those of the folder itself, which change with the names in it.
    """
    try:
        found = os.lstat(path)
    except OSError:
        return 0, 0, 0, 0
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def size_of(path: Path) -> int:
    """Return the size in bytes of a file, or of all files in a folder; links are not followed."""
    total, waiting = 0, [path]
    while waiting:
        current = waiting.pop()
        try:
            found = os.lstat(current)
            if stat.S_ISDIR(found.st_mode):
                waiting.extend(Path(current, name) for name in os.listdir(current))
            else:
                total += found.st_size
        except OSError:
            continue
    return total


def _newest(path: Path) -> float:
    """Return when a file, or a folder or one of the files in it, was changed last, in seconds since 1970."""
    try:
        times = [os.lstat(path).st_mtime]
        if os.path.isdir(path):
            times += [entry.stat(follow_symlinks=False).st_mtime for entry in os.scandir(path)]
    except OSError:
        return float("inf")
    return max(times)


def _is_recent(changed: float, now: float) -> bool:
    return changed > now - RECENT


def _is_harmless(problem: Problem) -> bool:
    """Return whether a file that cannot be read is certainly no artifact, not even a damaged one."""
    conventional = stem_of(problem.path) != problem.path.name.removesuffix(".h5")
    return problem.foreign and not conventional


def _was(reason: str) -> str:
    return reason if reason.startswith(("is ", "was ", "has ", "needs ", "cannot ")) else f"cannot be read ({reason})"
