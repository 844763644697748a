"""What an artifact is, whenever it was made: digests of content, and recipes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from artifacts import (
    ArtifactError,
    content_of,
    read_artifact,
    recipe_difference,
    recipe_of,
    store,
    verify_artifact,
    write_artifact,
)
from tests.artifacts.samples import OLD_FILES, PROVENANCE, demos_arrays

ARRAYS = {
    "weights/a": np.arange(3.0),
    "curve/seconds": np.array([1.0, 2.0]),
    "curve/return": np.array([0.5, 0.7]),
}
CONFIG = {"task": "reach", "rate": 1e-4, "without": [], "nested": [{"minutes": 3.0, "steps": 5}]}


@dataclass(frozen=True)
class Options:
    rate: float = 1e-4
    without: tuple[str, ...] = ()
    video: Path | None = None


@pytest.fixture
def policy(tmp_path, monkeypatch):
    """A function that writes a policy, with what differs from the usual one, and returns its content digest."""

    def write(folder="a", arrays=(), config=(), created="2026-01-01T00:00:00+00:00", **options):
        monkeypatch.setattr("artifacts.writing._now", lambda: created)
        given = {"seed": 7, "command": "ifo test", "config": CONFIG | dict(config), **options}
        path = write_artifact(tmp_path / folder / "x.policy.h5", "policy", ARRAYS | dict(arrays), **given)
        artifact = read_artifact(path)
        assert artifact.content == artifact.manifest.content == content_of(path)
        return artifact.content

    return write


def test_time_place_and_environment_are_no_part_of_the_content(policy, tmp_path, monkeypatch):
    usual = policy()
    alike = [
        policy(created="2027-02-02T00:00:00+00:00"),
        policy(folder="b/c"),
        policy(command="ifo test --workers 3"),
        policy(environment={"torch": "9"}),
        policy(summary={"seconds": 3.5}),
        policy(recipe=recipe_of("learn-policy", {"rate": 2}, 7)),
        policy(arrays={"curve/seconds": np.array([5.0, 6.0])}),
        policy(config={"nested": [{"minutes": 4.5, "steps": 5}]}),
        policy(config={"without": ()}),
    ]
    monkeypatch.setattr("artifacts.writing.ifo_version", lambda: "9.9")
    assert {usual, policy(), *alike} == {usual}


def test_what_an_artifact_is_is_its_content(policy, tmp_path):
    demos = write_artifact(tmp_path / "x.demos.h5", "demos", demos_arrays(), **PROVENANCE)
    others = write_artifact(tmp_path / "y.demos.h5", "demos", demos_arrays(1), **PROVENANCE)
    different = [
        policy(),
        policy(seed=8),
        policy(config={"rate": 2e-4}),
        policy(config={"nested": [{"minutes": 3.0, "steps": 6}]}),
        policy(arrays={"weights/a": np.arange(3.0) + 1}),
        policy(arrays={"weights/a": np.arange(3)}),
        policy(arrays={"curve/return": np.array([0.5, 0.8])}),
        policy(arrays={"more": np.zeros(2)}),
        policy(parents=[demos]),
        policy(parents=[others]),
        policy(parents=[demos, others]),
        policy(parents=[others, demos]),
    ]
    assert len(set(different)) == len(different)
    assert policy(parents=[demos]) == policy(parents=[read_artifact(demos)])


def test_the_content_does_not_drift(policy):
    """Children on disk hold these digests of their parents."""
    assert policy() == "ecf573215afa287313c012d494313811ace92d10b69d1ea635576fd716524446"


def test_an_evaluation_does_not_depend_on_the_names_of_policies(tmp_path):
    def content(name, context):
        config = {"runs": [{"policy": name, "context_seed": context, "learning_minutes": context + len(name)}]}
        arrays = {"final_distance": np.zeros((1, 2))}
        path = tmp_path / "x.evaluation.h5"
        return content_of(write_artifact(path, "evaluation", arrays, config=config, seed=0, command=""))

    assert content("a.policy.h5", 0) == content("longer.policy.h5", 0) != content("a.policy.h5", 1)


def test_a_parent_that_is_made_again_alike_spoils_nothing(translator, demos):
    write_artifact(demos, "demos", demos_arrays(), **{**PROVENANCE, "command": "ifo test, again"})
    assert verify_artifact(translator).parents == 1
    assert read_artifact(translator).parent("demos", check=True).manifest.command == "ifo test, again"
    write_artifact(demos, "demos", demos_arrays(1), **PROVENANCE)
    with pytest.raises(ArtifactError, match=r"x\.translator\.h5 was made from .*x\.demos\.h5, which has changed since"):
        read_artifact(translator).parent("demos", check=True)


def test_a_parent_that_is_replaced_just_after_its_check_is_refused(translator, demos, monkeypatch):
    """Another file in its place would be read without a word."""
    plain = store.is_unchanged

    def replaced(parent, found):
        same = plain(parent, found)
        write_artifact(demos, "demos", demos_arrays(1), **PROVENANCE)
        return same

    monkeypatch.setattr(store, "is_unchanged", replaced)
    parent = read_artifact(translator).parent("demos", check=True)
    with pytest.raises(ArtifactError, match=r"x\.demos\.h5"):
        parent["frames"]


def test_a_parent_is_recorded_as_it_was_when_it_was_opened(tmp_path, demos):
    opened, content = read_artifact(demos), content_of(demos)
    write_artifact(demos, "demos", demos_arrays(1), **PROVENANCE)
    child = write_artifact(tmp_path / "x.translator.h5", "translator", ARRAYS, **PROVENANCE, parents=[opened])
    assert read_artifact(child).manifest.parents[0].content == content != content_of(demos)


def test_a_recipe_is_whole_and_plain(demos):
    recipe = recipe_of("train-translator", Options(without=("rec",), video=Path("a")), np.int64(3), [demos])
    assert recipe == {
        "stage": "train-translator",
        "config": {"rate": 1e-4, "without": ["rec"], "video": "a"},
        "seed": 3,
        "parents": [content_of(demos)],
    }
    assert recipe == recipe_of("train-translator", recipe["config"], 3, [read_artifact(demos)])
    with pytest.raises(TypeError):
        recipe_of("train-translator", {"rate": {1, 2}}, 3)


def test_what_a_recipe_would_do_differently_is_named(tmp_path, demos):
    other = write_artifact(tmp_path / "other.demos.h5", "demos", demos_arrays(1), **PROVENANCE)
    usual = {"stage": "train-translator", "config": Options(rate=float("nan")), "seed": 3, "parents": [demos]}
    path = tmp_path / "x.translator.h5"
    summary = {"psnr": 20.5, "video": "x.mp4"}
    write_artifact(
        path, "translator", ARRAYS, **PROVENANCE, parents=[demos], recipe=recipe_of(**usual), summary=summary
    )
    artifact = read_artifact(path)
    assert artifact.manifest.summary == summary

    def difference(**changes):
        return recipe_difference(artifact, recipe_of(**usual | changes))

    assert difference() == [] == recipe_difference(artifact.manifest, recipe_of(**usual))
    assert difference(seed=4) == ["seed"]
    assert difference(stage="translate", seed=4) == ["stage"]
    assert difference(parents=[other]) == difference(parents=[]) == ["input file"]
    assert difference(config=Options(rate=2, without=("rec",)), seed=4, parents=[other]) == [
        "rate",
        "without",
        "seed",
        "input file",
    ]
    assert difference(config={"rate": float("nan"), "without": [], "new": 1}) == ["new", "video"]
    write_artifact(demos, "demos", demos_arrays(), **{**PROVENANCE, "command": "ifo test, again"})
    assert difference() == []


def test_the_order_of_keys_makes_no_difference_beside_nan(tmp_path):
    options = {"low": float("nan"), "high": 1}
    path = tmp_path / "x.translator.h5"
    write_artifact(path, "translator", ARRAYS, **PROVENANCE, recipe=recipe_of("train-translator", {"a": options}, 3))
    for same in (options, dict(reversed(options.items()))):
        assert recipe_difference(read_artifact(path), recipe_of("train-translator", {"a": same}, 3)) == []
    other = recipe_of("train-translator", {"a": {**options, "high": 2}}, 3)
    assert recipe_difference(read_artifact(path), other) == ["a"]


def test_an_artifact_that_records_no_recipe_says_so(translator):
    recipe = recipe_of("train-translator", {}, 7)
    assert recipe_difference(read_artifact(translator), recipe) == ["no record of what it was made with"]
    assert recipe_difference(read_artifact(OLD_FILES["policy"]), recipe) == ["made by an older ifo"]
