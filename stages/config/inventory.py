"""Options of ls and gc, the commands that look at whole folders."""

from __future__ import annotations

from dataclasses import dataclass

from artifacts.pipeline import STAGE_FILES
from stages.config.fields import Config, option

RUNS = "runs"  # the default folder
LISTED = (*dict.fromkeys(files.writes for files in STAGE_FILES.values()), "checkpoint")
SORTS = ("kind", "size", "age", "path")
CLEANED = ("orphans", "superseded", "unused")  # what gc removes only if it is asked to


@dataclass(frozen=True)
class ListConfig(Config):
    """Configuration of ls."""

    kind: tuple[str, ...] = option((), "Kind to list (repeatable; default: all).", LISTED)
    sort: str = option("kind", "Order: by kind, largest first, newest first, or by path.", SORTS)
    tree: bool = option(False, "Show each artifact below the one that it was made from.", names=("--tree",))


@dataclass(frozen=True)
class CleanConfig(Config):
    """Configuration of gc."""

    include: tuple[str, ...] = option(
        (), "Category to remove as well, see below (repeatable; default: only leftovers).", CLEANED
    )
    delete: bool = option(False, "Remove what is listed.", names=("--delete",))
