"""Paths that lead nowhere, to something other than a file, or cannot be used at all."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from artifacts import ArtifactError, PlatformError, paths, read_artifact, verify_artifact, write_artifact
from artifacts.atomic import atomic_folder, write_bytes
from tests.artifacts.forging import forge
from tests.artifacts.samples import PROVENANCE, demos_arrays


def pipe(folder):
    path = folder / "pipe.demos.h5"
    os.mkfifo(path)
    return path


def loop(folder):
    path = folder / "loop.demos.h5"
    path.symlink_to(path)
    return path


def socket_file(folder):
    path = folder / "socket.demos.h5"
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))
    return path


PLACES = {
    "pipe": (pipe, "not a regular file"),
    "socket": (socket_file, "not a regular file"),
    "device": (lambda _: Path("/dev/zero"), "not a regular file"),
    "folder": (lambda folder: folder, "is a folder"),
    "loop": (loop, "symbolic links"),
    "long name": (lambda folder: folder / ("x" * 300 + ".demos.h5"), "File name too long"),
    "below a file": (lambda folder: Path(__file__) / "x.demos.h5", "Not a directory"),
    "no path": (lambda folder: folder / "a\0b.demos.h5", "Invalid argument"),
}


@pytest.mark.parametrize("place", PLACES)
def test_what_is_no_file_is_refused_at_once(place, tmp_path):
    make, reason = PLACES[place]
    path = make(tmp_path)
    with pytest.raises(ArtifactError, match=reason):
        read_artifact(path)
    with pytest.raises(ArtifactError, match=r"cannot be read \("):
        paths.sha256_of(path)


@pytest.mark.parametrize("place", [place for place in PLACES if place != "no path"])
def test_a_parent_may_be_anything(place, translator, demos, tmp_path):
    path = PLACES[place][0](tmp_path)
    demos.unlink()
    child = forge(translator, tmp_path / "forged.translator.h5", parents=[{"kind": "demos", "path": str(path)}])
    for function in (verify_artifact, lambda path: read_artifact(path).parent("demos")):
        with pytest.raises(ArtifactError):
            function(child)


def test_a_folder_that_cannot_be_read_is_not_passed_over(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    for name in ("a/x.h5", "b/y.h5", "z.h5", "other"):
        (tmp_path / name).touch()
    (tmp_path / "again").symlink_to(tmp_path)
    assert [path.name for path in paths.files_below(tmp_path, ".h5")] == ["x.h5", "y.h5", "z.h5"]
    scandir = os.scandir

    def guarded(path):
        if Path(path).name == "b":
            raise PermissionError(13, "Permission denied")
        return scandir(path)

    monkeypatch.setattr(os, "scandir", guarded)
    with pytest.raises(ArtifactError, match=r"b: cannot be read \(Permission denied\)"):
        paths.files_below(tmp_path, ".h5")


def test_a_file_behind_a_closed_folder_is_not_missing(monkeypatch, translator, demos):
    def closed(path, *arguments, **options):
        if Path(path) == demos:
            raise PermissionError(13, "Permission denied")
        return stat(path, *arguments, **options)

    stat, artifact = os.stat, read_artifact(translator)
    monkeypatch.setattr(os, "stat", closed)
    with pytest.raises(ArtifactError, match=r"x\.demos\.h5: cannot be read \(Permission denied\)"):
        artifact.parent("demos")


@pytest.mark.parametrize("exists", [True, False])
def test_the_target_of_a_link_is_written_and_the_link_is_kept(tmp_path, exists, demos):
    target, link = tmp_path / "disk" / "real.translator.h5", tmp_path / "x.translator.h5"
    target.parent.mkdir()
    link.symlink_to(Path("disk") / target.name)
    if exists:
        target.write_text("old")
    weights = {"weights/a": demos_arrays()["final_distance"]}
    write_artifact(link, "translator", weights, **PROVENANCE, parents=[demos])
    assert link.is_symlink() and not target.is_symlink()
    assert verify_artifact(link).parents == verify_artifact(target).parents == 1
    assert os.listdir(target.parent) == [target.name]


def test_an_artifact_that_is_reached_by_a_link_finds_its_parents(translator, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    link = tmp_path / "elsewhere" / "y.translator.h5"
    link.symlink_to(translator)
    assert verify_artifact(link).parents == 1


def test_what_is_no_file_is_never_replaced(tmp_path):
    for path in (pipe(tmp_path), loop(tmp_path), socket_file(tmp_path)):
        before = os.lstat(path)
        with pytest.raises(PlatformError, match=rf"{path.name}: cannot be written"):
            write_bytes(path, b"new")
        assert os.lstat(path).st_ino == before.st_ino
    (tmp_path / "link").symlink_to("nowhere")
    with pytest.raises(PlatformError, match="of that name exists"), atomic_folder(tmp_path / "link"):
        pass


def test_any_name_that_the_file_system_allows_can_be_written(tmp_path):
    for name in ("x" * 255, "é" * 127):
        write_bytes(tmp_path / name, b"new")
        assert os.listdir(tmp_path) == [name]
        (tmp_path / name).unlink()
    with pytest.raises(PlatformError, match="File name too long"):
        write_bytes(tmp_path / ("x" * 256), b"new")
