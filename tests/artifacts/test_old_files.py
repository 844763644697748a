"""Files that schema 1 wrote, of every kind, read as if they were today's."""

from __future__ import annotations

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from artifacts import (
    KINDS,
    ArtifactError,
    ancestors,
    content_of,
    hdf5,
    migrations,
    read_artifact,
    read_checkpoint,
    recipe_of,
    store,
    verify_artifact,
    write_artifact,
)
from artifacts.layout import checked_names
from tests.artifacts.samples import OLD_CHECKPOINT, OLD_FILES, PROVENANCE, demos_arrays

KIND_NAMES = list(OLD_FILES)


@pytest.fixture
def old(tmp_path):
    """Copies of the old files: kind -> path."""
    return {kind: Path(shutil.copy(path, tmp_path)) for kind, path in OLD_FILES.items()}


def test_there_is_one_of_every_kind():
    assert {*OLD_FILES, "checkpoint"} == set(KINDS)


@pytest.mark.parametrize("kind", KIND_NAMES)
def test_an_old_file_is_read(kind):
    with h5py.File(OLD_FILES[kind]) as file:
        assert file.attrs["schema_version"] == 1
        stored = {name: file[name][...] for name in checked_names(file)}
    artifact = read_artifact(OLD_FILES[kind], kind)
    assert (artifact.manifest.schema_version, artifact.manifest.seed) == (KINDS[kind].version, 3)
    assert artifact.config["task"] == "tests.fixtures.small_reach:SmallReach"
    assert artifact.config["preset"] == "toy"
    assert artifact.names() == sorted(stored)
    for name, (shape, dtype) in artifact.describe().items():
        array = artifact[name]
        assert (array.shape, array.dtype) == (shape, dtype)
        assert array.tobytes() == stored[name].tobytes()


@pytest.mark.parametrize("kind", KIND_NAMES)
def test_an_old_file_verifies(kind):
    report = verify_artifact(OLD_FILES[kind])
    assert (report.kind, report.datasets) == (kind, len(read_artifact(OLD_FILES[kind]).names()))
    assert report.parents == (kind != "expert")


def test_the_lineage_of_old_files():
    found = [(item.parent.kind, item.state) for item in ancestors(read_artifact(OLD_FILES["evaluation"]), check=True)]
    assert found == [(kind, "present") for kind in ("policy", "translation", "translator", "demos", "expert")]


def test_damage_to_an_old_file_is_noticed(old):
    with h5py.File(old["demos"]) as file:
        chunk = file["frames"].id.get_chunk_info(0)
    data = bytearray(old["demos"].read_bytes())
    data[chunk.byte_offset + 100] ^= 1
    old["demos"].write_bytes(data)
    with pytest.raises(ArtifactError, match=r"small\.demos\.h5: dataset frames is damaged"):
        verify_artifact(old["demos"])


def test_an_old_child_notices_another_parent(old):
    policy = read_artifact(OLD_FILES["policy"])
    arrays = {name: policy[name] for name in policy.names()}
    again = {"config": policy.manifest.config, "seed": policy.manifest.seed, "command": policy.manifest.command}
    write_artifact(old["policy"], "policy", arrays, **again, parents=[old["translation"]])
    [item, *_] = ancestors(read_artifact(old["evaluation"]), check=True)
    assert (item.parent.kind, item.state) == ("policy", "changed")
    for function in (
        lambda: verify_artifact(old["evaluation"]),
        lambda: read_artifact(old["evaluation"]).parent("policy", check=True),
    ):
        with pytest.raises(ArtifactError, match="which has changed since"):
            function()


def test_a_new_child_of_an_old_file(old, tmp_path, monkeypatch):
    digested = []
    digest = hdf5.dataset_digest
    monkeypatch.setattr(hdf5, "dataset_digest", lambda dataset, *see: digested.append(dataset.name) or digest(dataset))
    monkeypatch.setattr(store, "sha256_of", None)
    child = write_artifact(
        tmp_path / "new.translator.h5", "translator", {"weights/a": np.zeros(2)}, **PROVENANCE, parents=[old["demos"]]
    )
    [parent] = read_artifact(child).manifest.parents
    assert parent.content == content_of(old["demos"]) == content_of(OLD_FILES["demos"]) != ""
    digested.clear()
    assert verify_artifact(child).parents == 1
    assert next(ancestors(read_artifact(child), check=True)).state == "present"
    assert recipe_of("train-translator", {}, 0, [old["demos"]])["parents"] == [parent.content]
    assert digested == ["/weights/a"], "the old parent was read once, when its content was recorded"
    write_artifact(old["demos"], "demos", demos_arrays(), **PROVENANCE)
    with pytest.raises(ArtifactError, match="which has changed since"):
        verify_artifact(child)


def test_the_content_of_old_files_does_not_drift():
    """Children on disk hold these digests; migrations of later schemas must not change them."""
    assert content_of(OLD_FILES["demos"]) == "23c345881feacb5fb88de13c301783b852976df35021eea6b19f263ea2d6540b"
    assert content_of(OLD_FILES["evaluation"]) == "590764d029ce281e951512514d940d2d35906a22b4b526a4f77c7a66dbb8c7ae"


def test_an_old_checkpoint_is_read():
    manifest, state = read_checkpoint(OLD_CHECKPOINT, stage="learn-policy")
    assert (manifest.kind, manifest.schema_version, manifest.seed) == ("checkpoint", KINDS["checkpoint"].version, 3)
    assert state["done"] == 4 and len(state["curve"]["seconds"]) == 4
    assert verify_artifact(OLD_CHECKPOINT).parents == 1


def test_the_configuration_of_a_checkpoint_is_migrated(monkeypatch):
    def rename(config):
        config["divergence"] = config.pop("kl")
        config.setdefault("warmup", 0)

    monkeypatch.setitem(migrations.CONFIGURATIONS, ("learn-policy", 1), rename)
    monkeypatch.setitem(migrations.CONFIGURATIONS, ("train-expert", 1), lambda config: config.clear())
    config = read_checkpoint(OLD_CHECKPOINT, stage="learn-policy")[0].config
    assert (config["divergence"], config["warmup"]) == (0.02, 0) and "kl" not in config
    assert "divergence" not in read_artifact(OLD_FILES["policy"]).config
