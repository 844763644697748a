"""Older schemas are read as if they were today's, from a committed old file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from artifacts import KINDS, ArtifactError, DatasetSpec, KindSpec, read_artifact, verify_artifact
from artifacts import migrations as module

OLD = Path(__file__).parents[1] / "fixtures" / "specimen_v1.specimen.h5"


def write_fixture():
    """Made the committed file once; kept to show what schema 1 of this test-only kind was."""
    from artifacts import write_artifact

    KINDS["specimen"] = KindSpec(1, {"distance_cm": DatasetSpec(("N",), ("f",))})
    arrays = {
        "distance_cm": np.array([10.0, 25.0]),
        "pictures": np.arange(8, dtype=np.uint8).reshape(2, 4),
        "unused": np.zeros(3),
    }
    write_artifact(OLD, "specimen", arrays, config={"rate": 3}, seed=1, command="ifo specimen")


@pytest.fixture
def specimen(monkeypatch):
    """Today's schema: 3, metres, named lengths."""
    datasets = {"distance": DatasetSpec(("N",), ("f",)), "weights": DatasetSpec(("N",), ("f",))}
    monkeypatch.setitem(KINDS, "specimen", KindSpec(3, datasets))
    monkeypatch.setattr(module, "MIGRATIONS", {})

    @module.migration("specimen", 1)
    def _metres(manifest, arrays):
        arrays.rename("distance_cm", "distance")
        arrays.change("distance", lambda array: array / 100)
        arrays.drop("unused")
        manifest["config"]["unit"] = "m"

    @module.migration("specimen", 2)
    def _weights(manifest, arrays):
        arrays.change("distance", lambda array: array + 1)  # Not the same as before `_metres`.
        arrays.add("weights", np.ones(2))
        arrays.change("weights", lambda array: array * 2)
        arrays.change("weights", lambda array: array + 1)
        manifest["config"]["learning_rate"] = manifest["config"].pop("rate")


def test_an_old_file_reads_like_a_new_one(specimen):
    before = OLD.read_bytes()
    artifact = read_artifact(OLD, "specimen")
    assert artifact.manifest.schema_version == 3
    assert artifact.config == {"unit": "m", "learning_rate": 3}
    assert artifact.names() == ["distance", "pictures", "weights"]
    np.testing.assert_array_equal(artifact["distance"], [1.1, 1.25])
    np.testing.assert_array_equal(artifact.read("distance", slice(1, 2)), [1.25])
    np.testing.assert_array_equal(artifact["weights"], [3, 3])
    np.testing.assert_array_equal(artifact.read("pictures", 1), [4, 5, 6, 7])
    assert verify_artifact(OLD).datasets == 3
    assert OLD.read_bytes() == before


def test_steps_are_applied_in_order(specimen, monkeypatch):
    order = []
    for version in (1, 2):
        step = module.MIGRATIONS["specimen", version]

        def noted(manifest, arrays, version=version, step=step):
            order.append((version, manifest["schema_version"]))
            step(manifest, arrays)

        monkeypatch.setitem(module.MIGRATIONS, ("specimen", version), noted)
    read_artifact(OLD)
    assert order == [(1, 1), (2, 2)]


def test_a_missing_step_says_so(specimen):
    del module.MIGRATIONS["specimen", 2]
    with pytest.raises(ArtifactError, match=r"is of specimen schema 2, which is no longer supported: make it again"):
        read_artifact(OLD)


def test_a_migrated_file_must_fit_the_schema(specimen, monkeypatch):
    monkeypatch.setitem(module.MIGRATIONS, ("specimen", 2), lambda manifest, arrays: None)
    with pytest.raises(ArtifactError, match="dataset weights is missing"):
        read_artifact(OLD)


@pytest.mark.parametrize("config", [{"stage": []}, {"stage": {}}, {}, [], None])
def test_a_checkpoint_of_a_strange_stage_needs_no_step(config):
    fields = {"kind": "checkpoint", "schema_version": 1, "config": config}
    module.migrate(fields, module.ArrayView(()))
    assert fields["config"] == config and fields["schema_version"] == KINDS["checkpoint"].version
