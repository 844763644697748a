"""view: one artifact as one HTML page that opens in any browser: what it is, where it comes from, what it shows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

from artifacts import (
    COMMANDS,
    Artifact,
    PlatformError,
    UsageError,
    ancestors,
    check_data,
    open_regular,
    read_artifact,
    sibling,
)
from artifacts.atomic import write_bytes
from artifacts.lineage import MOST_READ, Ancestor
from stages.reporting.description import (
    KEY_FIGURES,
    key_figures,
    sentence,
    value_text,
    values_without_folders,
    without_folders,
)
from stages.reporting.lineage import AncestorEntry, ancestor_entry, origin_of
from stages.reporting.media import media_of
from stages.reporting.page import HEAD, VIEWER, View, made_by_view, view_page
from stages.runtime.progress import Progress
from stages.runtime.run import StageResult

SHOWN_VALUES = 300  # of the configuration, and as many key figures
SHOWN_ANCESTORS = 100
REST = "`ifo inspect --json` shows all"


def view(path: Path, out: Path | None, progress: Progress) -> StageResult:
    """Write the page of an artifact of any kind.

    The page contains everything that it shows, and no absolute paths.

    Args:
        path: The artifact.
        out: The page; None: NAME.KIND.html next to the artifact.
        progress: Prints messages.

    Raises:
        ArtifactError: The file is damaged, or is no artifact of a stage. Nothing is written.
        UsageError: A file that would be replaced was not written by `ifo view`. Nothing is written.
    """
    out = out or sibling(path, ".html")
    _check_replaceable(out)
    artifact = read_artifact(path, tuple(COMMANDS))
    data = _data_status(artifact)
    media = media_of(artifact)
    chain = list(islice(ancestors(artifact, check=True), SHOWN_ANCESTORS + 1))
    notes = [without_folders(note.replace(str(path.parent) + os.sep, "")) for note in media.notes]
    if len(chain) > SHOWN_ANCESTORS:
        notes.append(f"Only the first {SHOWN_ANCESTORS} files of the lineage are shown ({REST}).")
    page = view_page(
        View(
            title=path.name,
            origin=f"Made by {VIEWER} on {datetime.now(UTC).isoformat(timespec='seconds')}.",
            sentence=without_folders(sentence(artifact)),
            figures=_texts(_figures(artifact)),
            sections=media.sections,
            videos=[replace(video, path=video.path and Path(video.path.name)) for video in media.videos],
            notes=notes,
            origins=_texts(_origins(artifact, data)),
            ancestors=list(_entries(artifact, chain[:SHOWN_ANCESTORS])),
            config=_texts({name: value for name, value in artifact.config.items() if name not in KEY_FIGURES}),
        )
    )
    write_bytes(out, page.encode("utf-8", "backslashreplace"))
    size = out.stat().st_size
    progress.say(f"view: {artifact.kind}, videos {len(media.videos)}, {size / 1e6:.1f} MB")
    return StageResult(out, {"of": artifact.kind, "videos": len(media.videos), "bytes": size})


def _check_replaceable(out: Path) -> None:
    """Refuse to replace a file that is not a page of `ifo view`."""
    if not os.path.isfile(out):
        if os.path.lexists(out):
            raise UsageError(f"{out} exists, and is not a file: choose another --out")
        return
    try:
        with open_regular(out) as file:
            ours = made_by_view(file.read(HEAD))
    except OSError as error:
        raise PlatformError(f"{out}: cannot be read ({error.strerror}): choose another --out") from error
    if not ours:
        raise UsageError(f"{out} exists, and `{VIEWER}` did not write it: choose another --out")


def _data_status(artifact: Artifact) -> str:
    """Check the data of a file that is not too large, and say what was checked.

    Raises:
        ArtifactError: The data is damaged.
    """
    if artifact.path.stat().st_size > MOST_READ:
        return f"not checked, because the file is larger than {MOST_READ >> 20} MiB: `ifo verify` checks it"
    count = len(check_data(artifact))
    if not artifact.manifest.datasets:
        return f"readable: datasets {count}, without digests (schema 1)"
    return f"intact: datasets {count}, each with the digest that was recorded for it"


def _figures(artifact: Artifact) -> dict[str, Any]:
    """The figures that the stage printed, and those of the data."""
    printed = {name: value for name, value in artifact.manifest.summary.items() if not isinstance(value, str)}
    return {**printed, **key_figures(artifact)}


def _origins(artifact: Artifact, data: str) -> dict[str, Any]:
    """What is known of the file."""
    manifest = artifact.manifest
    versions = ", ".join(f"{name} {value}" for name, value in manifest.environment.items() if value)
    return {
        "file": artifact.path.name,
        **origin_of(artifact),
        "schema version": str(manifest.schema_version),
        "digest": manifest.content or "not recorded (schema 1)",
        "data": data,
        "environment": versions,
    }


def _entries(artifact: Artifact, chain: list[Ancestor]) -> Iterator[AncestorEntry]:
    """The files that an artifact was made from, with paths relative to its folder."""
    folder = os.path.abspath(artifact.path.parent)
    for item in chain:
        entry = ancestor_entry(item)
        path = without_folders(os.path.relpath(os.path.abspath(item.path), folder))
        status = {} if entry.gone else {"status": "present, with the content that was recorded"}
        yield replace(entry, path=path, facts=_texts({**status, **entry.facts}))


def _texts(values: dict[str, Any]) -> dict[str, str]:
    """Values of a file as texts, without absolute paths; of very many, the first."""
    shown = values_without_folders(dict(islice(values.items(), SHOWN_VALUES)))
    texts = {value_text(name, REST): value_text(value, REST) for name, value in shown.items()}
    if len(values) > SHOWN_VALUES:
        texts["..."] = f"{len(values) - SHOWN_VALUES} more ({REST})"
    return texts
