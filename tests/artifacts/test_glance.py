"""A glance at an artifact, a survey of folders, and the relations among what is found."""

from __future__ import annotations

import os

import h5py
import numpy as np
import pytest

from artifacts import ArtifactError, read_artifact, write_artifact
from artifacts.family import Family
from artifacts.glance import glance
from artifacts.survey import distinct, survey
from tests.artifacts.samples import OLD_FILES, PROVENANCE, demos_arrays
from tests.artifacts.sketches import record, sketch


def test_a_glance_sees_what_reading_sees(tmp_path):
    path = write_artifact(tmp_path / "x.demos.h5", "demos", demos_arrays(n=4), **PROVENANCE)
    seen = glance(path, ("frames", "nothing"))
    assert seen.manifest == read_artifact(path).manifest
    assert seen.shapes == {"frames": (4, 5, 8, 10, 3)} and seen.bytes == path.stat().st_size


@pytest.mark.parametrize("kind", OLD_FILES)
def test_a_glance_at_old_files_migrates_them(kind):
    seen = glance(OLD_FILES[kind], ("frames",))
    assert seen.manifest == read_artifact(OLD_FILES[kind]).manifest
    assert set(seen.shapes) == ({"frames"} if kind == "demos" else set())


def test_a_glance_reads_no_data(tmp_path):
    path = write_artifact(tmp_path / "x.demos.h5", "demos", demos_arrays(), **PROVENANCE)
    data = path.read_bytes()
    frames = demos_arrays()["frames"].tobytes()[:64]
    at = data.index(frames)
    path.write_bytes(data[:at] + bytes(64) + data[at + 64 :])
    assert glance(path).kind == "demos"


def test_a_glance_follows_no_link_to_another_file(tmp_path):
    other = write_artifact(tmp_path / "other.demos.h5", "demos", demos_arrays(), **PROVENANCE)
    path = sketch(tmp_path / "x.demos.h5")
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        file["frames"] = h5py.ExternalLink(str(other), "frames")
    assert glance(path, ("frames",)).shapes == {}


def test_damage_is_one_line(tmp_path):
    path = sketch(tmp_path / "x.demos.h5", arrays={"frames": np.zeros((1, 2, 3, 4, 3), np.uint8)})
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(ArtifactError, match=r"x\.demos\.h5 is truncated or damaged"):
        glance(path)


def test_a_survey_finds_each_thing_once(tmp_path):
    inside = sketch(tmp_path / "a" / "x.demos.h5")
    outside = sketch(tmp_path / "out" / "y.demos.h5")
    (tmp_path / "a" / "link.demos.h5").symlink_to(inside)
    (tmp_path / "a" / "far.demos.h5").symlink_to(outside)
    (tmp_path / "a" / "folder").symlink_to(tmp_path / "out")
    (tmp_path / "a" / ".x.demos.h5.tmp-abcd_123").mkdir()
    (tmp_path / "a" / ".x.demos.h5.tmp-abcd_123" / "new.h5").write_text("not looked at")
    (tmp_path / "a" / "x.policy.tensorboard").mkdir()
    (tmp_path / "a" / "x.demos.mp4").write_text("")
    found = survey([tmp_path / "a", tmp_path / "a" / "." / ".." / "a"])
    assert len(found.artifacts) == 3 and len(found.links) == 2
    assert [item.path.name for item in distinct(found)] == ["far.demos.h5", "x.demos.h5"]
    assert [path.name for path in found.temporary] == [".x.demos.h5.tmp-abcd_123"]
    assert [path.name for path in found.tensorboard] == ["x.policy.tensorboard"]
    assert [path.name for path in found.files] == ["x.demos.mp4"] and found.problems == []


def test_a_survey_goes_on_where_something_cannot_be_read(tmp_path):
    sketch(tmp_path / "x.demos.h5")
    (tmp_path / "empty.policy.h5").write_text("")
    with h5py.File(tmp_path / "lift.h5", "w") as file:
        file["data"] = 1
    os.mkfifo(tmp_path / "pipe.demos.h5")
    (tmp_path / "loop.demos.h5").symlink_to("loop.demos.h5")
    found = survey([tmp_path])
    assert [item.path.name for item in found.artifacts] == ["x.demos.h5"]
    assert {problem.path.name: problem.foreign for problem in found.problems} == {
        "empty.policy.h5": True,
        "lift.h5": True,
        "pipe.demos.h5": False,
        "loop.demos.h5": False,
    }


@pytest.fixture
def shut(monkeypatch):
    """A function that makes a folder unreadable, for root as well."""
    usual, closed = os.scandir, set()

    def scandir(path="."):
        if os.path.basename(path) in closed:
            raise PermissionError(13, "Permission denied")
        return usual(path)

    monkeypatch.setattr(os, "scandir", scandir)
    return closed.add


def test_a_folder_that_cannot_be_read_is_a_problem(tmp_path, shut):
    sketch(tmp_path / "shut" / "x.demos.h5")
    sketch(tmp_path / "y.demos.h5")
    shut("shut")
    found = survey([tmp_path])
    (problem,) = found.problems
    assert problem.path.name == "shut" and "cannot be read" in problem.reason and not problem.foreign
    assert len(found.artifacts) == 1
    with pytest.raises(ArtifactError, match=r"shut: cannot be read \(Permission denied\)"):
        survey([tmp_path / "shut"])


def test_a_named_folder_must_exist(tmp_path):
    with pytest.raises(ArtifactError, match="no such folder"):
        survey([tmp_path / "none"])


def family_of(*paths):
    return Family([glance(path) for path in paths])


def test_states_of_parents(tmp_path):
    demos = sketch(tmp_path / "x.demos.h5")
    damaged = tmp_path / "damaged.demos.h5"
    damaged.write_text("")
    records = {
        "ok": record(tmp_path / "c", demos),
        "changed": record(tmp_path / "c", demos, content="another"),
        "missing": record(tmp_path / "c", tmp_path / "none.demos.h5"),
        "unreadable": record(tmp_path / "c", damaged),
    }
    for state, parent in records.items():
        child = sketch(tmp_path / "x.translator.h5", [parent])
        family = family_of(child)
        assert family.state(family.members[0]) == state
        assert (family.parent(family.members[0], "demos") is not None) == (state == "ok")
    child = sketch(tmp_path / "x.translator.h5", list(records.values()))
    family = family_of(child)
    assert family.state(family.members[0]) == "missing"
    assert family.state(glance(demos)) == ""


def test_a_parent_that_was_moved_is_still_a_source(tmp_path):
    demos = sketch(tmp_path / "x.demos.h5")
    child = sketch(tmp_path / "x.translator.h5", [demos])
    moved = demos.rename(tmp_path / "moved.demos.h5")
    family = family_of(child, moved)
    assert family.state(family.members[0]) == "missing"
    assert [item.path for item in family.sources(family.members[0])] == [moved]


def test_descendants_come_first(tmp_path):
    demos = sketch(tmp_path / "x.demos.h5")
    translators = [sketch(tmp_path / f"{name}.translator.h5", [demos]) for name in "ab"]
    base = sketch(tmp_path / "c.translator.h5", [demos, translators[0]])
    policy = sketch(tmp_path / "a.policy.h5", [base, demos])
    family = family_of(demos, *translators, base, policy)
    order = [item.path for item in family.descendants_first(family.members)]
    assert sorted(order) == sorted([demos, *translators, base, policy])
    assert order.index(policy) < order.index(base) < order.index(translators[0]) < order.index(demos)
    assert order.index(translators[1]) < order.index(demos)
    assert family.needed([glance(base)]) == {base, demos, translators[0]}


def test_a_forged_circle_ends(tmp_path):
    a, b = tmp_path / "a.translator.h5", tmp_path / "b.translator.h5"
    sketch(a, [record(a, b)])
    sketch(b, [a])
    family = family_of(a, b)
    assert family.needed(family.members[:1]) == {a, b}
    assert len(family.descendants_first(family.members)) == 2
