"""Manifests, configurations and values that ifo never writes are refused when a file is opened or read."""

from __future__ import annotations

import json

import numpy as np
import pytest

from artifacts import ArtifactError, read_artifact, verify_artifact, write_artifact
from tests.artifacts.forging import forge
from tests.artifacts.samples import OLD_FILES, PROVENANCE

POLICY = {
    "weights/a": np.ones(3, np.float32),
    "contexts/goal": np.ones((1, 2)),
    "curve/samples": np.ones(2),
    "curve/seconds": np.array([1.0, np.nan]),
}
TRANSLATION = {
    "context_frame": np.zeros((8, 8, 3), np.uint8),
    "target_features": np.zeros((3, 4), np.float32),
    "target_images": np.zeros((3, 8, 8, 3), np.float32),
    "feature_scale": np.float32(1),
}
ARRAYS = {"policy": POLICY, "translation": TRANSLATION, "translator": {"weights/a": np.ones(3)}}


@pytest.fixture(params=["policy"])
def artifact(request, tmp_path):
    kind = request.param
    return write_artifact(tmp_path / f"x.{kind}.h5", kind, ARRAYS[kind], **PROVENANCE)


def refused(path, *parts):
    with pytest.raises(ArtifactError) as caught:
        read_artifact(path)
    text = str(caught.value)
    assert "\n" not in text and len(text) < 500
    for part in (path.name, *parts):
        assert part in text


@pytest.mark.parametrize(
    ("field", "value", "part"),
    [
        ("kind", "x" * 100_000, "not an ifo artifact"),
        ("kind", 7, "not an ifo artifact"),
        ("schema_version", "9" * 5000, "not an ifo artifact"),
        ("schema_version", -1, "schema -1"),
        ("seed", "9" * 5000, "seed"),
        ("seed", -5, "seed"),
        ("seed", "many", "seed"),
        ("ifo_version", "9" * 5000, "ifo_version"),
        ("created", "9" * 5000, "created"),
        ("environment", json.dumps({"python": 3}), "environment.python"),
        ("environment", "[]", "environment"),
        ("datasets", json.dumps({"weights/a": 3}), "datasets.weights/a"),
        ("recipe", json.dumps({"config": []}), "recipe"),
        ("recipe", "null", "recipe"),
        ("summary", "[]", "summary"),
        ("summary", "{", "summary is not JSON"),
        ("summary", '{"a": ' + "9" * 5000 + "}", "summary is not JSON"),
        ("summary", '{"a": ' + "[" * 100_000 + "]" * 100_000 + "}", "summary is not JSON"),
        ("summary", '{"a": ' + "[" * 100 + "]" * 100 + "}", "nested too deeply"),
        ("config", '{"a": ' + "[" * 100 + "]" * 100 + "}", "nested too deeply"),
        ("parents", json.dumps([{"kind": "demos", "path": "a\0b"}]), "NUL"),
        ("parents", json.dumps([{"kind": "demos", "path": "x" * 5000}]), "parents.0.path"),
        ("parents", json.dumps([{"kind": ["demos"], "path": "x"}]), "parents.0.kind"),
        ("parents", json.dumps([{"kind": "", "path": "x"}]), "parents.0.kind"),
        ("parents", json.dumps([{"kind": "demos", "path": ""}]), "parents.0.path"),
        ("parents", json.dumps([3]), "parents.0"),
    ],
)
def test_a_strange_manifest_is_refused(artifact, tmp_path, field, value, part):
    refused(forge(artifact, tmp_path / "forged.policy.h5", attributes={field: value}), part)


@pytest.mark.parametrize(
    ("artifact", "name", "value"),
    [
        ("policy", "preset", []),
        ("policy", "task", 5),
        ("policy", "task", "x" * 100_000),
        ("policy", "learner", ["trpo"]),
        ("policy", "hidden", 10**12),
        ("policy", "hidden", 0),
        ("policy", "hidden", 64.5),
        ("policy", "hidden", "64"),
        ("policy", "hidden", True),
        ("policy", "without", [["feat"]]),
        ("policy", "translation_metrics", [1]),
        ("policy", "translation_metrics", {"psnr": "high"}),
        ("policy", "context_seed", -2),
        ("policy", "context_seed", 10**90),
        ("translation", "contexts", {}),
        ("translation", "vary", 3),
        ("translator", "size", [48]),
        ("translator", "size", [48, "48"]),
        ("translator", "demonstrations", -1),
        ("translator", "held_out_demonstrations", 0.5),
        ("translator", "without", "rec"),
    ],
    indirect=["artifact"],
)
def test_a_value_of_another_type_in_a_configuration_is_refused(artifact, tmp_path, name, value):
    path = forge(artifact, tmp_path / f"forged.{artifact.suffixes[0][1:]}.h5", config={name: value})
    refused(path, f"bad configuration: {name}")


NAN, INFINITE = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("artifact", "name", "value"),
    [
        ("policy", "weights/a", np.array([1, NAN], np.float32)),
        ("policy", "weights/a", np.array([1, INFINITE], np.float32)),
        ("policy", "contexts/goal", np.array([[NAN, 1]])),
        ("translation", "target_features", np.full((3, 4), NAN)),
        ("translation", "target_images", np.full((3, 8, 8, 3), INFINITE)),
        ("translation", "feature_scale", np.float32(NAN)),
        ("translator", "weights/a", np.array([NAN])),
    ],
    indirect=["artifact"],
)
def test_what_is_not_finite_is_neither_read_nor_written(artifact, tmp_path, name, value):
    kind = read_artifact(artifact).kind
    path = forge(artifact, tmp_path / f"forged.{kind}.h5", arrays={name: value})
    forged = read_artifact(path)
    group = (lambda: forged.group(name.split("/")[0])) if "/" in name else (lambda: forged.read(name, ...))
    for function in (lambda: forged[name], group, lambda: verify_artifact(path)):
        with pytest.raises(ArtifactError, match=rf"forged\.{kind}\.h5: dataset {name} holds values that are NaN"):
            function()
    with pytest.raises(ArtifactError, match=f"dataset {name} would hold values that are NaN"):
        write_artifact(tmp_path / "new.h5", kind, {**ARRAYS[kind], name: value}, **PROVENANCE)
    assert not (tmp_path / "new.h5").exists()


def test_what_may_be_undefined_is_read(artifact):
    assert np.isnan(read_artifact(artifact)["curve/seconds"][1])
    verify_artifact(artifact)


@pytest.mark.parametrize(
    ("artifact", "name", "value", "part"),
    [
        ("policy", "curve/samples", np.ones((2, 2)), "has shape (2, 2)"),
        ("policy", "curve/samples", np.ones(0), "without empty axes"),
        ("translation", "metrics/psnr", np.ones(3), "has shape (3,)"),
        ("translation", "metrics/psnr", np.array("high"), "expected float"),
        ("translation", "images", np.zeros((1, 3, 8, 9, 3), np.uint8), "with W = 8"),
        ("translation", "feature_scale", np.ones(2), "has shape (2,)"),
    ],
    indirect=["artifact"],
)
def test_datasets_of_another_shape_are_refused(artifact, tmp_path, name, value, part):
    refused(forge(artifact, tmp_path / "forged.h5", arrays={name: value}), f"dataset {name}", part)


@pytest.mark.parametrize("kind", OLD_FILES)
def test_files_of_the_past_pass(kind):
    artifact = read_artifact(OLD_FILES[kind])
    for name in artifact.names():
        artifact[name]
