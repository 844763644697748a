"""What may be removed: never an evaluation, never what a kept file was made from, never what is not ifo's."""

from __future__ import annotations

import itertools
import os
import tempfile
import time
from pathlib import Path

import h5py
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from artifacts import atomic, atomic_path
from artifacts.schema import Parent
from artifacts.usage import InUse
from stages.config.inventory import CLEANED
from stages.inventory.cleaning import plan
from stages.inventory.removal import remove
from tests.artifacts.sketches import DAY, record, sketch

PNG = b"\x89PNG\r\n\x1a\n and so on, and so on"
MP4 = b"\0\0\0\x20ftypisom and so on"
KINDS = ("expert", "demos", "translator", "translation", "policy", "evaluation", "checkpoint")


def old(path, data=b"", age=DAY):
    """Write a file that was changed a day ago."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    os.utime(path, (time.time() - age,) * 2)
    return path


def board(path, *names):
    """Make a TensorBoard folder of a day ago."""
    path.mkdir()
    for name in names or ("events.out.tfevents.1.host.2.0",):
        old(path / name)
    os.utime(path, (time.time() - DAY,) * 2)
    return path


def listed(folder, *include):
    """Names of what would be removed -> category, in order."""
    return {item.path.name: item.category for item in plan([folder], include).items}


def clean(folder, *include):
    """Remove, and return the reasons why something stays, by name."""
    return {one.item.path.name: one.reason for one in remove(plan([folder], include).items) if one.reason}


@pytest.fixture
def family(tmp_path):
    demos = sketch(tmp_path / "x.demos.h5")
    translator = sketch(tmp_path / "x.translator.h5", [demos])
    translation = sketch(tmp_path / "x-c0.translation.h5", [translator])
    policy = sketch(tmp_path / "x-c0.policy.h5", [translation])
    return demos, translator, translation, policy


def test_without_options_no_artifact_is_listed(family, tmp_path):
    found = plan([tmp_path])
    assert found.items == [] and {item.category for item in found.others} == {"unused"} and found.kept == []


def test_unused_are_listed_descendants_first(family, tmp_path):
    assert list(listed(tmp_path, "unused")) == [path.name for path in reversed(family)]
    assert clean(tmp_path, "unused") == {} and os.listdir(tmp_path) == []


def test_an_evaluation_keeps_all_that_it_was_made_from(family, tmp_path):
    sketch(tmp_path / "x-c0.evaluation.h5", [family[3]])
    spare = sketch(tmp_path / "y.translator.h5", [family[0]])
    found = plan([tmp_path], CLEANED)
    assert [item.path for item in found.items] == [spare]
    assert {item.reason for item in found.kept} == {"evaluation", f"needed by {tmp_path / 'x-c0.evaluation.h5'}"}
    assert clean(tmp_path, *CLEANED) == {} and not spare.exists() and all(path.exists() for path in family)


def test_an_evaluation_in_another_named_folder_counts(family, tmp_path):
    sketch(tmp_path / "results" / "x.evaluation.h5", [family[3]])
    runs = tmp_path / "runs"
    runs.mkdir()
    moved = [path.rename(runs / path.name) for path in family]
    assert len(plan([runs], CLEANED).items) == 4  # nothing in it needs them
    assert plan([runs, tmp_path / "results"], CLEANED).items == []  # found by content, although they were moved
    assert all(path.exists() for path in moved)


def test_an_unfinished_run_keeps_its_inputs(family, tmp_path):
    config = {"stage": "learn-policy"}
    sketch(tmp_path / "y.policy.checkpoint.h5", [family[2]], config=config)
    assert list(listed(tmp_path, *CLEANED)) == [family[3].name]


def test_the_checkpoint_of_a_finished_run_goes(family, tmp_path):
    config = {"stage": "learn-policy"}
    path = sketch(tmp_path / "x-c0.policy.checkpoint.h5", [family[2]], config=config, age=2 * DAY)
    assert listed(tmp_path) == {path.name: "checkpoint"}
    assert clean(tmp_path) == {} and not path.exists() and all(other.exists() for other in family)


@pytest.mark.parametrize("fault", ["newer", "other stage", "no artifact", "running", "damaged", "name"])
def test_other_checkpoints_stay(family, tmp_path, fault):
    path = tmp_path / "x-c0.policy.checkpoint.h5"
    config = {"stage": "train-expert" if fault == "other stage" else "learn-policy"}
    sketch(path, [family[2]], config=config, age=DAY / 2 if fault == "newer" else 2 * DAY)
    mark = None
    if fault == "no artifact":
        family[3].unlink()
    elif fault == "running":
        mark = InUse([board(tmp_path / "x-c0.policy.tensorboard")])
    elif fault == "damaged":
        path.write_bytes(path.read_bytes()[:-20])
    elif fault == "name":
        path = path.rename(tmp_path / "x-c0.policy.copy.h5")
    assert path.name not in listed(tmp_path, *CLEANED)
    del mark


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"config": {"stage": "import-demos"}, "recipe": {"stage": "import-demos"}}, "from its command"),
        ({"recipe": {}}, "from its command"),
        ({"recipe": {"stage": "translate", "config": {"context_image": "x.png"}}}, "from its command"),
        ({"command": "rm -rf /"}, "from its command"),
        ({"parents": [Parent(kind="expert", path="none.expert.h5", content="x")]}, "is missing"),
        ({"parents": [Parent(kind="expert", path="none.expert.h5", sha256="x")]}, "is missing"),
    ],
)
def test_what_cannot_be_made_again_stays(tmp_path, change, reason):
    parents = change.pop("parents", ())
    path = sketch(tmp_path / "x.demos.h5", parents, **change)
    found = plan([tmp_path], CLEANED)
    assert found.items == [] and [item.path for item in found.kept] == [path] and reason in found.kept[0].reason


def test_superseded_is_what_was_made_from_a_file_that_was_made_again(family, tmp_path):
    demos, translator, *rest = family
    sketch(demos, content="another")
    names = {path.name: "superseded" for path in (*rest, translator)}
    assert listed(tmp_path, "superseded") == names
    assert listed(tmp_path, "unused") == {}  # the demonstrations are needed by what stays
    assert listed(tmp_path, *CLEANED) == {**names, demos.name: "unused"}


def test_what_changed_just_now_stays(family, tmp_path):
    os.utime(family[2])
    assert list(listed(tmp_path, *CLEANED)) == [family[3].name]


def test_what_is_in_use_stays(family, tmp_path):
    mark = InUse([family[1]])
    assert list(listed(tmp_path, *CLEANED)) == [family[3].name, family[2].name]
    mark.end()
    items = plan([tmp_path], CLEANED).items
    mark = InUse([family[2]])  # a stage that begins between the listing and the removal
    stays = {one.item.path: one.reason for one in remove(items) if one.reason}
    assert stays[family[2]] == "in use by a running command"
    assert [path.exists() for path in family] == [True, True, True, False]
    del mark


def test_what_was_made_again_after_the_listing_stays(family, tmp_path):
    items = plan([tmp_path], CLEANED).items
    sketch(family[2], [family[1]], age=0)
    stays = {one.item.path: one.reason for one in remove(items) if one.reason}
    assert stays[family[2]] == "changed since it was listed" and set(stays) == set(family[:3])


@pytest.mark.parametrize("name", ["x.policy.h5", "foreign.h5"])
def test_what_cannot_be_read_keeps_all_artifacts(family, tmp_path, name):
    path = old(tmp_path / "sub" / name, b"\x89HDF\r\n\x1a\n damaged")
    left = tmp_path / "y.policy.mp4"
    old(left, MP4)
    found = plan([tmp_path], CLEANED)
    assert [item.path for item in found.items] == [left]
    assert len(found.notes) == 1 and str(path) in found.notes[0] and len(found.kept) == 4


def test_an_empty_file_with_the_name_of_an_artifact_keeps_all_artifacts(family, tmp_path):
    old(tmp_path / "e.evaluation.h5")
    assert listed(tmp_path, *CLEANED) == {}


def test_files_of_others_keep_nothing_and_stay(family, tmp_path):
    with h5py.File(tmp_path / "lift.h5", "w") as file:
        file["data"] = 1
    old(tmp_path / "notes.h5", b"mine")
    assert clean(tmp_path, *CLEANED) == {}
    assert sorted(os.listdir(tmp_path)) == ["lift.h5", "notes.h5"]


def test_a_folder_that_cannot_be_read_keeps_all_artifacts(family, tmp_path, monkeypatch):
    usual = os.scandir
    (tmp_path / "shut").mkdir()

    def scandir(path="."):
        if os.path.basename(path) == "shut":
            raise PermissionError(13, "Permission denied")
        return usual(path)

    monkeypatch.setattr(os, "scandir", scandir)
    found = plan([tmp_path], CLEANED)
    assert found.items == [] and "shut" in found.notes[0]


def test_links_and_what_they_lead_to_stay(family, tmp_path):
    (tmp_path / "link.policy.h5").symlink_to(family[3])
    assert listed(tmp_path, *CLEANED) == {}


def test_nothing_is_removed_through_a_link(tmp_path):
    outside, inside = tmp_path / "outside", tmp_path / "inside"
    inside.mkdir()
    far = sketch(outside / "far.policy.h5")
    picture = old(outside / "gone.policy.mp4", MP4)
    temporary = outside / ".x.policy.h5.tmp-abcdefgh"
    temporary.mkdir()
    (temporary / "new").write_text("")
    scalars = board(outside / "gone.policy.tensorboard")
    (inside / "folder").symlink_to(outside)
    for path in (far, picture, temporary, scalars):
        (inside / path.name).symlink_to(path)
    before = sorted(outside.rglob("*")), sorted(inside.iterdir())
    assert listed(inside, *CLEANED) == {} and clean(inside, *CLEANED) == {}
    assert (sorted(outside.rglob("*")), sorted(inside.iterdir())) == before


def test_a_file_replaced_by_a_link_after_the_listing_stays(family, tmp_path):
    items = plan([tmp_path], CLEANED).items
    far = family[3].rename(tmp_path.parent / f"{tmp_path.name}-far.policy.h5")
    family[3].symlink_to(far)
    stays = {one.item.path: one.reason for one in remove(items) if one.reason}
    assert stays[family[3]] == "changed since it was listed" and family[3].is_symlink() and far.exists()
    far.unlink()


def test_a_named_link_to_a_folder_is_followed(family, tmp_path):
    link = tmp_path.parent / f"{tmp_path.name}-link"
    link.symlink_to(tmp_path)
    assert len(listed(link, "unused")) == 4
    link.unlink()


def test_orphans(tmp_path):
    gone = [old(tmp_path / "x.policy.mp4", MP4), old(tmp_path / "x.demos.png", PNG)]
    gone.append(board(tmp_path / "x.expert.tensorboard"))
    old(tmp_path / "holiday.mp4", MP4)  # no kind
    old(tmp_path / "b.policy.mp4", b"mine")  # no video
    old(tmp_path / "b.policy.png", MP4)  # no picture
    old(tmp_path / ".policy.mp4", MP4)  # no name
    old(tmp_path / "b.checkpoint.mp4", MP4)  # nothing like it is written
    old(tmp_path / "new.policy.mp4", MP4, age=60)  # perhaps just before its artifact
    old(tmp_path / "x.demos.preview.png", PNG)  # has no artifact
    board(tmp_path / "mine.policy.tensorboard", "events.out.tfevents.1.host.2.0", "notes.txt")
    (tmp_path / "links.policy.tensorboard").mkdir()
    (tmp_path / "links.policy.tensorboard" / "events.out.tfevents.1").symlink_to("nowhere")
    sketch(tmp_path / "c.policy.h5", recipe={})
    old(tmp_path / "c.policy.mp4", MP4)
    sketch(tmp_path / "d.policy.checkpoint.h5")
    board(tmp_path / "d.policy.tensorboard")
    others = sorted(set(tmp_path.iterdir()) - set(gone))
    assert listed(tmp_path) == {}
    assert set(listed(tmp_path, "orphans")) == {path.name for path in gone}
    assert clean(tmp_path, *CLEANED) == {} and sorted(tmp_path.iterdir()) == others


def test_a_run_before_its_first_checkpoint_keeps_its_files(tmp_path):
    scalars = board(tmp_path / "x.policy.tensorboard")
    old(tmp_path / "x.policy.mp4", MP4)
    items = plan([tmp_path], CLEANED).items
    mark = InUse([scalars])
    assert listed(tmp_path, *CLEANED) == {}
    assert {one.item.path.name: one.reason for one in remove(items) if one.reason} == {
        "x.policy.tensorboard": "in use by a running command"
    }
    del mark


def test_an_orphan_whose_artifact_is_written_after_the_listing_stays(tmp_path):
    picture = old(tmp_path / "x.policy.mp4", MP4)
    items = plan([tmp_path], CLEANED).items
    sketch(tmp_path / "x.policy.h5")
    assert [one.reason for one in remove(items)] == ["its artifact is there again"] and picture.exists()


def test_what_belongs_to_an_artifact_goes_with_it(tmp_path):
    artifact = sketch(tmp_path / "x.policy.h5")
    names = ["x.policy.mp4", "x.policy.png", "x.policy.preview.png"]
    for name in names:
        old(tmp_path / name, MP4 if name.endswith("mp4") else PNG)
    board(tmp_path / "x.policy.tensorboard")
    sketch(tmp_path / "own.h5", kind="policy")
    mine = old(tmp_path / "own.mp4", MP4)  # no NAME.KIND.h5, so perhaps the user's
    assert set(listed(tmp_path, "unused")) == {artifact.name, *names, "x.policy.tensorboard", "own.h5"}
    mark = InUse([artifact])
    items = plan([tmp_path], CLEANED).items
    assert [item.path.name for item in items] == ["own.h5"]
    del mark
    assert clean(tmp_path, "unused") == {} and list(tmp_path.iterdir()) == [mine]


def test_links_and_pipes_do_not_belong_to_an_artifact(tmp_path):
    artifact = sketch(tmp_path / "runs" / "x.policy.h5")
    far = old(tmp_path / "far.mp4", MP4)
    (tmp_path / "runs" / "x.policy.mp4").symlink_to(far)
    os.mkfifo(tmp_path / "runs" / "x.policy.png")
    (tmp_path / "runs" / "x.policy.tensorboard").symlink_to(board(tmp_path / "far"))
    assert listed(tmp_path / "runs", *CLEANED) == {artifact.name: "unused"}
    assert clean(tmp_path / "runs", *CLEANED) == {} and far.exists()


def test_what_killed_commands_left_goes(tmp_path):
    for name in (".x.policy.h5.tmp-abc_1234", ".footage.tmp-abcdefgh"):
        (tmp_path / name / "new").mkdir(parents=True)
        (tmp_path / name / "new" / "x.mp4").write_bytes(bytes(1000))
    (tmp_path / ".y.h5.tmp-abcdefgh").mkdir()
    (tmp_path / ".mine.tmp-abcdefgh").mkdir()
    (tmp_path / ".mine.tmp-abcdefgh" / "notes.txt").write_text("")
    (tmp_path / ".short.tmp-abc").mkdir()
    (tmp_path / "x.tmp-abcdefgh").mkdir()
    found = plan([tmp_path]).items
    assert sorted(item.bytes for item in found) == [0, 1000, 1000] and {item.category for item in found} == {
        "temporary"
    }
    assert clean(tmp_path) == {}
    assert sorted(os.listdir(tmp_path)) == [".mine.tmp-abcdefgh", ".short.tmp-abc", "x.tmp-abcdefgh"]


def test_a_file_that_is_being_written_stays(tmp_path):
    with atomic_path(tmp_path / "x.policy.h5") as temporary:
        temporary.write_text("half")
        assert listed(tmp_path, *CLEANED) == {}
    assert (tmp_path / "x.policy.h5").read_text() == "half"
    assert atomic._prefix(tmp_path / "x.policy.h5") == ".x.policy.h5.tmp-"


def test_what_cannot_be_removed_keeps_what_it_was_made_from(family, tmp_path, monkeypatch):
    usual = os.unlink

    def unlink(path, *more, **options):
        if Path(path) == family[2]:
            raise PermissionError(13, "Permission denied")
        usual(path, *more, **options)

    monkeypatch.setattr(os, "unlink", unlink)
    outcomes = {one.item.path: one for one in remove(plan([tmp_path], CLEANED).items)}
    assert outcomes[family[2]].error and "Permission denied" in outcomes[family[2]].reason
    assert [path.exists() for path in family] == [True, True, True, False]


def test_files_of_a_million_years_are_no_bug(tmp_path):
    path = sketch(tmp_path / "x.demos.h5")
    os.utime(path, (2**40, 2**40))
    assert plan([tmp_path], CLEANED).items == []


@st.composite
def graphs(draw):
    """Files with their parents: (kind, [(parent's index, what the record says of it)], change of the file)."""
    nodes = []
    for index in range(draw(st.integers(1, 9))):
        above = draw(st.lists(st.integers(0, index - 1), max_size=3, unique=True)) if index else []
        records = [(parent, draw(st.sampled_from(["same", "same", "same", "other", "moved"]))) for parent in above]
        change = draw(st.sampled_from(["", "", "", "", "recent", "no recipe", "link", "missing", "used"]))
        nodes.append((draw(st.sampled_from(KINDS)), records, change))
    return nodes


def build(folder, nodes):
    """Write the files of a graph; return their paths, and marks of those that are in use."""
    paths, marks = [], []
    for index, (kind, records, change) in enumerate(nodes):
        name = f"n{index}.policy.checkpoint.h5" if kind == "checkpoint" else f"n{index}.{kind}.h5"
        path = folder / ("sub" if index % 3 == 0 else ".") / name
        parents = []
        for parent, state in records:
            one = record(path, paths[parent], content="another" if state == "other" else None)
            parents.append(one.model_copy(update={"path": "elsewhere.h5"}) if state == "moved" else one)
        if change == "missing":
            parents.append(Parent(kind="demos", path="never.demos.h5", content="never"))
        more = {"recipe": {}} if change == "no recipe" else {}
        paths.append(sketch(path, parents, kind=kind, age=10 if change == "recent" else DAY * (20 - index), **more))
        if change == "link":
            (folder / f"link{index}.{kind}.h5").symlink_to(path)
        if change == "used":
            marks.append(InUse([path]))
    return paths, marks


@settings(max_examples=60, deadline=None)
@given(graphs(), st.sets(st.sampled_from(CLEANED)), st.integers(0, 12))
def test_no_kept_file_ever_loses_what_it_was_made_from(nodes, include, steps):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths, marks = build(folder, nodes)
        items = plan([folder], sorted(include)).items
        assert all(path.exists() for path in paths)  # nothing is touched by looking
        for one in itertools.islice(remove(items), steps):  # an interrupt may come after any of them
            assert one.reason == ""
        for index, (kind, records, change) in enumerate(nodes):
            if kind in ("evaluation", "checkpoint") or change in ("recent", "link", "used"):
                assert paths[index].exists()
            if paths[index].exists():
                assert all(paths[parent].exists() for parent, _ in records)
        if steps >= len(items):
            assert not any(item.path.exists() for item in items)
        del marks


@settings(max_examples=30, deadline=None)
@given(graphs())
def test_what_nothing_needs_is_all_removed(nodes):
    """The removal is not only safe but complete: what stays is needed, protected, or cannot be made again."""
    nodes = [(kind, [(parent, "same") for parent, _ in records], "") for kind, records, _ in nodes]
    with tempfile.TemporaryDirectory() as name:
        paths, _ = build(Path(name), nodes)
        for _ in remove(plan([Path(name)], CLEANED).items):
            pass
        needed = {index for index, node in enumerate(nodes) if node[0] in ("evaluation", "checkpoint")}
        for index in reversed(range(len(nodes))):
            if index in needed:
                needed |= {parent for parent, _ in nodes[index][1]}
        assert {index for index, path in enumerate(paths) if path.exists()} == needed
