"""What an artifact was made from."""

from __future__ import annotations

import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from artifacts import Parent, ancestors, lineage, read_artifact, verify_artifact, write_artifact
from tests.artifacts.forging import forge
from tests.artifacts.samples import OLD_FILES, PROVENANCE, demos_arrays


@pytest.fixture
def translation(tmp_path, translator):
    arrays = {
        "context_frame": np.zeros((8, 8, 3), np.uint8),
        "target_features": np.zeros((3, 4)),
        "target_images": np.zeros((3, 8, 8, 3), np.uint8),
    }
    return write_artifact(tmp_path / "x.translation.h5", "translation", arrays, **PROVENANCE, parents=[translator])


def states(path, **options):
    return [(item.depth, item.parent.kind, item.state) for item in ancestors(read_artifact(path), **options)]


def test_all_generations_are_there(translation):
    expected = [(1, "translator", "present"), (2, "demos", "present")]
    assert states(translation) == states(translation, check=True) == expected
    assert states(translation, parents=[]) == []


def test_a_branch_ends_where_a_file_is_gone(translation, translator, demos, monkeypatch):
    demos.unlink()
    assert states(translation) == [(1, "translator", "present"), (2, "demos", "missing")]
    monkeypatch.chdir(translation.parent)
    [_, gone] = ancestors(read_artifact(translation.name))
    assert str(gone.path) == demos.name  # by the way the reader came, not by this machine's
    translator.write_text("no")
    [item] = ancestors(read_artifact(translation))
    assert item.state == "unreadable" and item.artifact is None and str(translator) in item.problem


def test_a_file_that_took_anothers_place_is_noticed(translation, demos):
    write_artifact(demos, "demos", demos_arrays(seed=1), **PROVENANCE)
    assert states(translation)[1] == (2, "demos", "present")
    assert states(translation, check=True)[1] == (2, "demos", "changed")


def test_a_file_that_was_made_again_alike_is_the_same(translation, demos, monkeypatch):
    monkeypatch.setattr("artifacts.writing.ifo_version", lambda: "9.9")
    write_artifact(demos, "demos", demos_arrays(), **{**PROVENANCE, "command": "ifo test --workers 2"})
    assert read_artifact(demos).manifest.ifo_version == "9.9"
    assert states(translation, check=True)[1] == (2, "demos", "present")


def test_of_a_large_old_file_the_date_tells(tmp_path, monkeypatch):
    monkeypatch.setattr(lineage, "MOST_READ", 0)
    monkeypatch.setattr(lineage, "is_unchanged", None)  # nothing is read
    for kind in ("expert", "demos"):
        shutil.copy(OLD_FILES[kind], tmp_path)
    demos = tmp_path / OLD_FILES["demos"].name
    assert states(demos, check=True) == [(1, "expert", "present")]
    monkeypatch.setattr("artifacts.writing._now", lambda: "2999-01-01T00:00:00+00:00")
    write_artifact(tmp_path / OLD_FILES["expert"].name, "expert", {"weights/a": np.zeros(2)}, **PROVENANCE)
    assert states(demos, check=True) == [(1, "expert", "changed")]


def test_a_tree_of_equal_parents_is_walked_once(tmp_path, demos):
    """Ten parents in each of eight generations are a hundred million paths."""
    above = demos
    for generation in range(8):
        path = tmp_path / f"{generation}.demos.h5"
        write_artifact(path, "demos", demos_arrays(), **PROVENANCE, parents=[above] * 10)
        above = path
    assert len(states(above, check=True)) == 80
    assert verify_artifact(above).parents == 10


def test_a_file_may_claim_to_be_its_own_parent(tmp_path, demos):
    own = {"kind": "demos", "path": "forged.demos.h5", "content": "c"}
    path = forge(demos, tmp_path / "forged.demos.h5", attributes={"content": "c"}, parents=[own])
    assert states(path, check=True) == [(1, "demos", "present"), (2, "demos", "present")]


def test_a_long_line_of_ancestors(tmp_path, monkeypatch):
    def generation(k):
        parents = [Parent(kind="demos", path=f"{k + 1}.demos.h5")] if k < 3000 else []
        return SimpleNamespace(path=tmp_path / f"{k}.demos.h5", manifest=SimpleNamespace(parents=parents))

    monkeypatch.setattr(lineage, "_opened", lambda path: generation(int(path.name.split(".")[0])))
    assert sum(1 for _ in ancestors(generation(0))) == 3000
