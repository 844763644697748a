"""Artifacts, the files that stages exchange: schema, atomic writing, verification, lineage, video.

Public names are loaded on first use, so importing this package takes no time.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from artifacts.atomic import atomic_folder, atomic_path
    from artifacts.checkpoint import checkpoint_path, read_checkpoint, remove_checkpoint, write_checkpoint
    from artifacts.errors import ArtifactError, IfoError, Interrupted, PlatformError, UsageError
    from artifacts.kinds import KINDS, DatasetSpec, KindSpec
    from artifacts.lineage import Ancestor, ancestors
    from artifacts.paths import default_path, open_regular, sha256_of, sibling, stem_of
    from artifacts.pipeline import COMMANDS, STAGE_FILES
    from artifacts.recipe import recipe_difference, recipe_of
    from artifacts.schema import Manifest, Parent
    from artifacts.store import Artifact, content_of, is_unchanged, read_artifact
    from artifacts.tree import pack, unpack
    from artifacts.verification import VerifyReport, check_data, verify_artifact
    from artifacts.video import (
        caption,
        contact_sheet,
        image_size,
        mp4_bytes,
        open_video,
        overview,
        png_bytes,
        read_mp4,
        read_png,
        tile_videos,
        write_mp4,
        write_overview,
        write_png,
    )
    from artifacts.writing import write_artifact

_MODULE_OF = {
    name: module
    for module, names in {
        "atomic": ("atomic_folder", "atomic_path"),
        "checkpoint": ("checkpoint_path", "read_checkpoint", "remove_checkpoint", "write_checkpoint"),
        "errors": ("ArtifactError", "IfoError", "Interrupted", "PlatformError", "UsageError"),
        "lineage": ("Ancestor", "ancestors"),
        "pipeline": ("COMMANDS", "STAGE_FILES"),
        "recipe": ("recipe_difference", "recipe_of"),
        "kinds": ("KINDS", "DatasetSpec", "KindSpec"),
        "schema": ("Manifest", "Parent"),
        "paths": ("default_path", "open_regular", "sha256_of", "sibling", "stem_of"),
        "store": ("Artifact", "content_of", "is_unchanged", "read_artifact"),
        "tree": ("pack", "unpack"),
        "verification": ("VerifyReport", "check_data", "verify_artifact"),
        "video": (
            "caption",
            "contact_sheet",
            "image_size",
            "mp4_bytes",
            "open_video",
            "overview",
            "png_bytes",
            "read_mp4",
            "read_png",
            "tile_videos",
            "write_mp4",
            "write_overview",
            "write_png",
        ),
        "writing": ("write_artifact",),
    }.items()
    for name in names
}

__all__ = [
    "COMMANDS",
    "KINDS",
    "STAGE_FILES",
    "Ancestor",
    "Artifact",
    "ArtifactError",
    "DatasetSpec",
    "IfoError",
    "Interrupted",
    "KindSpec",
    "Manifest",
    "Parent",
    "PlatformError",
    "UsageError",
    "VerifyReport",
    "ancestors",
    "atomic_folder",
    "atomic_path",
    "caption",
    "check_data",
    "checkpoint_path",
    "contact_sheet",
    "content_of",
    "default_path",
    "image_size",
    "is_unchanged",
    "mp4_bytes",
    "open_regular",
    "open_video",
    "overview",
    "pack",
    "png_bytes",
    "read_artifact",
    "read_checkpoint",
    "read_mp4",
    "read_png",
    "recipe_difference",
    "recipe_of",
    "remove_checkpoint",
    "sha256_of",
    "sibling",
    "stem_of",
    "tile_videos",
    "unpack",
    "verify_artifact",
    "write_artifact",
    "write_checkpoint",
    "write_mp4",
    "write_overview",
    "write_png",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'artifacts' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"artifacts.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
