"""Artifacts: round trips, wrong files, lineage."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import h5py
import hypothesis.extra.numpy as npst
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import artifacts
from artifacts import (
    KINDS,
    ArtifactError,
    Manifest,
    Parent,
    content_of,
    default_path,
    read_artifact,
    sibling,
    stem_of,
    verify_artifact,
    write_artifact,
)
from artifacts.kinds import SCHEMA
from tests.artifacts.samples import PROVENANCE, demos_arrays

storable = st.one_of(
    npst.boolean_dtypes(),
    npst.integer_dtypes(),
    npst.unsigned_integer_dtypes(),
    npst.floating_dtypes(),
    npst.complex_number_dtypes(),
    npst.byte_string_dtypes(),
    npst.unicode_string_dtypes(endianness="="),
)


def fails(message, function, *args, **kwargs):
    """Call, expect an ArtifactError of one line that holds every part of `message`."""
    with pytest.raises(ArtifactError) as caught:
        function(*args, **kwargs)
    text = str(caught.value)
    assert "\n" not in text
    for part in (message,) if isinstance(message, str) else message:
        assert part in text


def test_what_was_written_is_read(demos):
    artifact = read_artifact(demos, "demos")
    expected = demos_arrays()
    assert artifact.kind == "demos" and artifact.path == demos
    assert artifact.names() == sorted(expected)
    assert artifact.names("contexts/") == ["contexts/angle"]
    assert "frames" in artifact and "nothing" not in artifact
    for name, array in expected.items():
        assert artifact[name].dtype == array.dtype
        np.testing.assert_array_equal(artifact[name], array)
    np.testing.assert_array_equal(artifact.read("frames", (slice(1, 3), 0)), expected["frames"][1:3, 0])
    assert list(artifact.group("contexts")) == list(artifact.group("contexts/")) == ["angle"]
    assert artifact.group("nothing") == {}


def test_the_manifest_tells_where_it_comes_from(translator, demos):
    manifest = read_artifact(translator).manifest
    assert manifest.config == PROVENANCE["config"]
    assert (manifest.seed, manifest.command, manifest.schema_version) == (7, "ifo test", SCHEMA)
    assert manifest.created.endswith("+00:00")
    assert manifest.parents == [Parent(kind="demos", path="x.demos.h5", content=content_of(demos))]
    assert list(manifest.datasets) == ["weights/encoder/0"]
    assert (manifest.recipe, manifest.summary) == ({}, {})


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(npst.arrays(storable, npst.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5)))
def test_any_array_comes_back_exactly(tmp_path, array):
    path = write_artifact(tmp_path / "a.checkpoint.h5", "checkpoint", {"g/a": array}, **PROVENANCE)
    verify_artifact(path)
    found = read_artifact(path)["g/a"]
    assert (found.dtype, found.shape) == (array.dtype, array.shape)
    assert found.tobytes() == array.tobytes()


@pytest.mark.parametrize("shape", [(3, 1_000_000), (1_000_000, 3), (7, 100, 100, 3), (1, 2_000_003)])
def test_big_arrays_come_back_exactly(tmp_path, shape):
    array = np.random.default_rng(0).random(shape, dtype=np.float32)
    path = write_artifact(tmp_path / "a.checkpoint.h5", "checkpoint", {"a": array}, **PROVENANCE)
    np.testing.assert_array_equal(read_artifact(path)["a"], array)
    assert path.stat().st_size < 1.34 * array.nbytes + 10_000


def test_every_dataset_is_checksummed(demos):
    with h5py.File(demos) as file:
        assert file["frames"].fletcher32 and file["final_distance"].fletcher32
        types = [file.attrs.get_id(name).dtype for name in file.attrs]
    assert {kind.kind for kind in types} == {"i", "S"}, "HDF5 has no checksum for strings of variable length"


def test_odd_but_legal_manifests(tmp_path):
    odd = {
        "config": {"long": "é" * 100_000, "path": Path("a"), "scalar": np.float32(0.5), "inf": float("inf")},
        "seed": 2**127,
        "command": "ifo \udcff 'a\nb'",
        "environment": {"python": "3.11"},
    }
    path = write_artifact(tmp_path / "a.checkpoint.h5", "checkpoint", {}, **odd)
    manifest = read_artifact(path).manifest
    assert manifest.seed == 2**127 and manifest.environment == {"python": "3.11"}
    assert manifest.command == "ifo \\udcff 'a\nb'"
    assert manifest.config == {"long": "é" * 100_000, "path": "a", "scalar": 0.5, "inf": float("inf")}
    assert Manifest.from_attributes(manifest.to_attributes()) == manifest


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        ("nothing", {}, "is not a kind of artifact"),
        ("demos", {"frames": None}, "dataset frames is missing, expected uint8 (N, T, H, W, 3)"),
        ("demos", {"frames": np.zeros((4, 5, 8, 10, 3))}, "frames is float64, expected uint8"),
        ("demos", {"frames": np.zeros((4, 5, 8, 3), np.uint8)}, "has shape (4, 5, 8, 3)"),
        ("demos", {"frames": np.zeros((4, 5, 8, 10, 4), np.uint8)}, "has shape (4, 5, 8, 10, 4)"),
        ("demos", {"times": np.zeros((4, 3))}, "with T = 5"),
        ("demos", {"final_distance": np.zeros(3)}, "with N = 4"),
        ("demos", {"a//b": np.zeros(3)}, "not usable"),
        ("demos", {"../b": np.zeros(3)}, "not usable"),
        ("demos", {"frames/b": np.zeros(3)}, "cannot also be the group"),
        ("demos", {"objects": np.array([None])}, "type object"),
        ("policy", {}, "weights/* is missing"),
    ],
)
def test_unfit_arrays_are_refused_before_writing(tmp_path, leftovers, kind, change, message):
    arrays = {name: a for name, a in (demos_arrays() | change).items() if a is not None}
    fails(("new.demos.h5", message), write_artifact, tmp_path / "new.demos.h5", kind, arrays, **PROVENANCE)
    assert list(tmp_path.iterdir()) == []


def test_a_translation_may_have_float_images(tmp_path):
    arrays = {
        "context_frame": np.zeros((8, 8, 3), np.uint8),
        "target_features": np.zeros((5, 16), np.float32),
        "target_images": np.zeros((5, 8, 8, 3), np.float32),
    }
    write_artifact(tmp_path / "a.translation.h5", "translation", arrays, **PROVENANCE)
    arrays["target_images"] = arrays["target_images"].astype(np.uint8)
    write_artifact(tmp_path / "a.translation.h5", "translation", arrays, **PROVENANCE)


def test_wrong_kind(demos):
    fails(
        "is a demos artifact, expected a translator: pass the file that `ifo train-translator` printed",
        read_artifact,
        demos,
        "translator",
    )
    fails("expected an expert or a policy", read_artifact, demos, ("expert", "policy"))
    assert read_artifact(demos, ("expert", "demos")).kind == "demos"


def test_files_that_are_no_artifacts(tmp_path):
    fails(("none.h5", "no such file", "`ifo collect-demos`"), read_artifact, tmp_path / "none.h5", "demos")
    fails("is a folder", read_artifact, tmp_path, "demos")
    text = tmp_path / "text.h5"
    for content in (b"", b"hello", b"\x89HDF\r\n\x1a\n"):
        text.write_bytes(content)
        fails("text.h5", read_artifact, text, "demos")
    fails("is not HDF5", read_artifact, __file__)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["a"] = [1, 2]
    fails("is HDF5 but not an ifo artifact", read_artifact, tmp_path / "other.h5")


def test_a_newer_schema_asks_for_an_upgrade(demos, monkeypatch):
    assert read_artifact(demos).manifest.schema_version == KINDS["demos"].version == SCHEMA
    monkeypatch.setitem(KINDS, "demos", artifacts.KindSpec(SCHEMA + 1, KINDS["demos"].datasets))
    newer = write_artifact(demos.with_name("n.demos.h5"), "demos", demos_arrays(), **PROVENANCE)
    monkeypatch.undo()
    message = f"was written by a newer ifo (schema {SCHEMA + 1}, this one reads up to {SCHEMA}): upgrade ifo"
    fails(message, read_artifact, newer)


def test_an_unknown_kind_asks_for_an_upgrade(tmp_path, monkeypatch):
    monkeypatch.setitem(KINDS, "oracle", artifacts.KindSpec())
    path = write_artifact(tmp_path / "a.oracle.h5", "oracle", {}, **PROVENANCE)
    monkeypatch.undo()
    fails("is an oracle artifact, which this ifo does not know: upgrade ifo", read_artifact, path)


def test_a_changed_attribute_is_noticed(demos):
    with h5py.File(demos, "a") as file:
        file.attrs["seed"] = 8
    fails("damaged manifest", read_artifact, demos)


def test_links_out_of_the_file_are_not_followed(demos, tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["secret"] = [1, 2]
    with h5py.File(demos, "a") as file:
        file["stolen"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "secret")
    assert "stolen" not in read_artifact(demos)
    with h5py.File(demos, "a") as file:
        file.create_dataset("raw", (4,), "u1", external=str(tmp_path / "secret.h5"))
    fails("do not trust this file", read_artifact, demos)


def test_a_file_holds_what_its_manifest_lists(demos):
    with h5py.File(demos, "a") as file:
        file.create_dataset("bare", data=[1, 2], fletcher32=True)
    fails("dataset bare is not in the manifest", read_artifact, demos)
    with h5py.File(demos, "a") as file:
        del file["bare"], file["contexts/angle"]
    fails("dataset contexts/angle is missing", read_artifact, demos)


def test_an_unknown_dataset_is_named(demos):
    fails(("x.demos.h5 has no dataset nothing", "frames"), read_artifact(demos).read, "nothing")


def test_a_replaced_file_is_not_mixed_with_the_old_one(demos):
    artifact = read_artifact(demos)
    write_artifact(demos, "demos", demos_arrays(1), **PROVENANCE)
    fails("was replaced or removed while in use", artifact.read, "frames")


def test_parents_are_found_and_checked(translator, demos, tmp_path, monkeypatch):
    assert read_artifact(translator).parent("demos", check=True).path.samefile(demos)
    fails(("x.translator.h5", "no expert among its parents"), read_artifact(translator).parent, "expert")
    report = verify_artifact(translator)
    assert (report.kind, report.datasets, report.parents) == ("translator", 1, 1)
    assert report.bytes == translator.stat().st_size

    monkeypatch.chdir(tmp_path)
    assert read_artifact("x.translator.h5").parent("demos").path == Path("x.demos.h5")

    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for path in (translator, demos):
        path.rename(moved / path.name)
    assert verify_artifact(moved / translator.name).parents == 1

    write_artifact(moved / demos.name, "demos", demos_arrays(1), **PROVENANCE)
    artifact = read_artifact(moved / translator.name)
    assert artifact.parent("demos").kind == "demos"
    changed = ("x.translator.h5 was made from", "x.demos.h5, which has changed since")
    fails(changed, artifact.parent, "demos", check=True)
    fails(changed, verify_artifact, artifact.path)

    (moved / demos.name).unlink()
    missing = ("x.translator.h5 was made from", "x.demos.h5, which is missing", "`ifo collect-demos`")
    fails(missing, artifact.parent, "demos")
    fails(missing, verify_artifact, artifact.path)


def test_parents_in_other_folders_and_behind_links(demos, tmp_path):
    (tmp_path / "disk" / "deep").mkdir(parents=True)
    (tmp_path / "runs").symlink_to(tmp_path / "disk" / "deep")
    arrays = {"weights/a": np.zeros(3)}
    path = tmp_path / "runs" / "y.policy.h5"
    write_artifact(path, "policy", arrays, **PROVENANCE, parents=[demos])
    assert read_artifact(path).manifest.parents[0].path == "../../x.demos.h5"
    assert verify_artifact(path).parents == 1


def test_an_artifact_cannot_replace_its_parent(demos):
    before = demos.read_bytes()
    fails(
        "would replace its own input",
        write_artifact,
        demos,
        "demos",
        demos_arrays(),
        **PROVENANCE,
        parents=[demos],
    )
    assert demos.read_bytes() == before


def test_names():
    assert default_path("runs", "x", "demos") == Path("runs/x.demos.h5")
    assert sibling("runs/x.demos.h5", ".mp4") == Path("runs/x.demos.mp4")
    for name in ("x.demos.h5", "x.policy.checkpoint.h5", "x.checkpoint.h5", "x.h5"):
        assert stem_of(Path("runs") / name) == "x"
    assert stem_of("reach.v2.demos.h5") == "reach.v2"


def test_importing_costs_little():
    code = """
import sys, artifacts, artifacts.errors
print(*{"numpy", "h5py", "av", "cv2", "pydantic"} & set(sys.modules))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=os.getcwd())
    assert run.stdout.strip() == ""


def test_every_public_name_exists():
    for name in artifacts.__all__:
        assert getattr(artifacts, name) is not None
    assert set(artifacts.__all__) == set(artifacts._MODULE_OF)
    with pytest.raises(AttributeError):
        artifacts.nothing  # noqa: B018
