"""The listing of artifacts: task, method, key figures, order, tree."""

from __future__ import annotations

import numpy as np
import pytest

from artifacts import read_artifact
from artifacts.survey import survey
from stages.inventory.figures import figures_of, key_figure
from stages.inventory.listing import listing, tree
from stages.reporting.methods import describe_method
from tests.artifacts.samples import OLD_FILES
from tests.artifacts.sketches import DAY, record, sketch


@pytest.fixture
def family(tmp_path):
    frames = np.zeros((2, 5, 8, 10, 3), np.uint8)
    demos = sketch(tmp_path / "x.demos.h5", arrays={"frames": frames}, age=6 * DAY)
    config = {"steps": 9, "without": ["rec"], "align": "dtw", "task": "reach"}
    translator = sketch(tmp_path / "x.translator.h5", [demos], config=config, age=5 * DAY)
    translation = sketch(tmp_path / "x-c0.translation.h5", [translator], age=4 * DAY)
    config = {"reward": "translation", "without": ["img"], "negatives": 5, "task": "reach"}
    policy = sketch(tmp_path / "x-c0.policy.h5", [translation], config=config, age=3 * DAY)
    return demos, translator, translation, policy


@pytest.mark.parametrize(
    ("kind", "figures", "expected"),
    [
        ("expert", {"success": 0.973, "normalised_distance": 0.01}, "success 97.3%, distance 0.010"),
        ("translator", {"psnr": 25.14, "feature_ratio": 0.423}, "PSNR 25.1 dB, feature ratio 0.42"),
        ("translation", {"psnr": 30.0, "tau_returns": 0.66, "demonstrations": 8}, "PSNR 30.0 dB, tau 0.66"),
        ("translation", {"return_target": -0.5, "return_still": -1}, "return -0.50"),
        ("policy", {"normalised_distance": 0.1234, "success": 0.5}, "distance 0.123, success 50%"),
        ("policy", {"env_return": -3.456}, "return -3.46"),
        (
            "evaluation",
            {"succeeded": 9, "runs": 10, "normalised_distance_stochastic": 0.09, "normalised_distance": 0.5},
            "9 of 10 runs succeed, distance 0.090",
        ),
        ("evaluation", {"success": 0.5, "env_return": 2, "env_return_stochastic": 1}, "success 50%, return 1.00"),
        ("translator", {"psnr": None, "feature_ratio": "x"}, ""),
        ("translator", {"psnr": float("nan"), "feature_ratio": True}, ""),
        ("demos", {"demos": 3}, ""),
        ("checkpoint", {"success": 1.0}, ""),
    ],
)
def test_key_figures(kind, figures, expected):
    assert key_figure(kind, figures) == expected


def test_demonstrations_tell_their_number_and_size(family):
    (row,) = (row for row in listing([family[0]]).rows)
    assert row.key == "2 videos of 5 frames, 10x8"


def test_old_files_tell_what_their_datasets_hold():
    found = {
        item.kind: figures_of(item)
        for item in survey([OLD_FILES["demos"].parent]).artifacts
        if "small" in item.path.name
    }
    translator = read_artifact(OLD_FILES["translator"])
    assert found["translator"]["psnr"] == pytest.approx(float(translator["metrics/psnr"]))
    policy = read_artifact(OLD_FILES["policy"])
    assert found["policy"]["normalised_distance"] == pytest.approx(float(policy["curve/normalised_distance"][-1]))
    rows = {row.kind: row for row in listing([OLD_FILES["demos"].parent]).rows}
    assert "PSNR" in rows["translator"].key and "distance" in rows["policy"].key
    assert rows["policy"].intact == "unchecked"


def test_methods_are_named_as_in_the_report(family):
    rows = {row.kind: row for row in listing([family[0].parent]).rows}
    described, problem = describe_method(policy_of(family))
    assert problem == "" and rows["policy"].method == described["method"]
    assert rows["policy"].method == "translation without rec, img, aligned, negatives"
    assert rows["translator"].method == rows["translation"].method == "translation without rec, aligned"


def policy_of(family):
    """The policy as a stage reads it, whose parents are only manifests."""

    class Light:
        def __init__(self, path):
            self.path, found = path, next(item for item in survey([path]).artifacts)
            self.manifest = found.manifest
            self.config = found.manifest.config

        def __contains__(self, name):
            return False

        def parent(self, kind, check):
            return Light(self.path.parent / next(one.path for one in self.manifest.parents if one.kind == kind))

    return Light(family[3])


def test_a_changed_file_does_not_name_the_method(family):
    demos, translator = family[:2]
    sketch(translator, [demos], content="another", config={"steps": 0})
    rows = {row.kind: row for row in listing([demos.parent]).rows}
    assert rows["translation"].intact == "changed"
    assert rows["policy"].method == "translation without img, negatives (translator unknown)"


def test_an_evaluation_names_the_methods_of_its_runs(tmp_path):
    runs = [{"reward": "oracle"}, {"reward": "gail", "own_context": True}, {"reward": "oracle"}]
    sketch(tmp_path / "x.evaluation.h5", config={"task": "push", "runs": runs})
    (row,) = listing([tmp_path]).rows
    assert (row.method, row.task) == ("oracle, gail, own context", "push")


@pytest.mark.parametrize(
    "config", [{"runs": 3}, {"runs": [4]}, {"runs": [{}]}, {}, {"runs": [{"reward": "translation", "translator": 1}]}]
)
def test_forged_records_have_no_method(tmp_path, config):
    sketch(tmp_path / "x.evaluation.h5", config=config)
    (row,) = listing([tmp_path]).rows
    assert row.method == ""


@pytest.mark.parametrize("created", ["yesterday", "", "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00"])
def test_forged_dates_do_not_matter(tmp_path, created):
    sketch(tmp_path / "x.demos.h5", created=created)
    (row,) = listing([tmp_path], sort="age").rows
    assert row.created.tzinfo is not None and isinstance(row.created.timestamp(), float)


def test_an_environment_is_the_task(tmp_path):
    environment = {"name": "Reacher-v5", "kwargs": {}, "seed": 0, "control_steps": 5, "frames": 2, "size": [4, 4]}
    environment |= {"crop": None, "viewpoint": None, "success": ""}
    sketch(tmp_path / "x.policy.h5", config={"task": None, "environment": environment})
    (row,) = listing([tmp_path]).rows
    assert row.task == "Reacher-v5"


def test_checkpoints_tell_what_became_of_the_run(tmp_path):
    config = {"stage": "learn-policy"}
    sketch(tmp_path / "a.policy.checkpoint.h5", config=config, age=2 * DAY)
    sketch(tmp_path / "b.policy.checkpoint.h5", config=config, age=2 * DAY)
    sketch(tmp_path / "b.policy.h5", age=DAY)
    sketch(tmp_path / "c.policy.checkpoint.h5", config=config, age=DAY)
    sketch(tmp_path / "c.policy.h5", age=2 * DAY)  # made again
    keys = {row.path.name[0]: row.key for row in listing([tmp_path], ["checkpoint"]).rows}
    assert keys == {"a": "unfinished learn-policy", "b": "left by a finished run", "c": "unfinished learn-policy"}


def test_the_order(family, tmp_path):
    def order(**options):
        return [row.kind for row in listing([tmp_path], **options).rows]

    assert order() == ["demos", "translator", "translation", "policy"]
    assert order(sort="age") == ["policy", "translation", "translator", "demos"]
    assert order(sort="path") == ["policy", "translation", "demos", "translator"]
    assert order(sort="size")[0] == "demos"
    assert order(kinds=["policy", "demos"]) == ["demos", "policy"]


def test_the_tree_shows_each_file_once_below_its_first_parent(family, tmp_path):
    policy = sketch(tmp_path / "y.policy.h5", [family[2]])
    sketch(tmp_path / "x.evaluation.h5", [policy, family[3]])
    rows = listing([tmp_path], sort="path").rows
    shown = [(depth, row.path.name) for depth, row in tree(rows)]
    assert (
        shown
        == [
            (0, "x.demos.h5"),
            (1, "x.translator.h5"),
            (2, "x-c0.translation.h5"),
            (3, "x-c0.policy.h5"),
            (3, "y.policy.h5"),
            (4, "x.evaluation.h5"),
        ]
        or shown[5][1] == "y.policy.h5"
    )
    assert len(shown) == len(rows) == len({name for _, name in shown})


def test_a_forged_circle_is_shown_once(tmp_path):
    a, b = tmp_path / "a.translator.h5", tmp_path / "b.translator.h5"
    sketch(a, [record(a, b)])
    sketch(b, [a])
    rows = listing([tmp_path]).rows
    assert [(depth, row.path.name) for depth, row in tree(rows)] == [(0, a.name), (1, b.name)]
