"""Names of methods, and the files that they are read from."""

from __future__ import annotations

import numpy as np
import pytest

from artifacts import read_artifact, write_artifact
from stages.reporting.methods import describe_method
from stages.reporting.names import method_name, short_name

TRAINED = {"steps": 9}
RUNS = [
    ({"reward": "gail", "own_context": True}, "gail, own context", "gail-own"),
    ({"reward": "gail", "own_context": False}, "gail", "gail"),
    ({"reward": "gail", "translator": TRAINED}, "gail", "gail"),  # from before demonstrations could be so recorded
    ({"reward": "gail"}, "gail (demonstrations unknown)", "gail-demonstrations-unknown"),
    ({"reward": "joints", "translator": {}}, "joints (demonstrations unknown)", "joints-demonstrations-unknown"),
    ({"reward": "oracle", "without": []}, "oracle", "oracle"),
    ({"reward": "oracle", "own_context": True}, "oracle", "oracle"),  # it learns nothing from demonstrations
    ({"reward": "translation", "translator": TRAINED}, "translation", "translation"),
    ({"reward": "translation"}, "translation (translator unknown)", "translation-translator-unknown"),
    (
        {"reward": "translation", "without": ["img"], "translator": {}, "own_context": False},
        "translation without img (translator unknown)",
        "without-img-translator-unknown",
    ),
    (
        {"reward": "translation", "translator": TRAINED, "own_context": None},
        "translation (demonstrations unknown)",
        "translation-demonstrations-unknown",
    ),
    ({"reward": "translation", "translator": {"steps": 0, "without": []}}, "random", "random"),
    ({"reward": "translation", "translator": TRAINED, "untranslated": 1}, "untranslated", "untranslated"),
    (
        {"reward": "translation", "translator": TRAINED, "untranslated": 200},
        "untranslated mean of 200",
        "untranslated-mean-of-200",
    ),
    ({"reward": "video", "translator": TRAINED, "untranslated": 1}, "video", "video"),
    ({"reward": "video", "translator": {"steps": 0}}, "video, untrained", "video-untrained"),
    ({"reward": "video", "without": ["img"], "translator": TRAINED}, "video without img", "video-without-img"),
    (
        {"reward": "translation", "without": ["img"], "translator": TRAINED},
        "translation without img",
        "without-img",
    ),
    (
        {"reward": "translation", "without": ["feat"], "translator": {"steps": 9, "without": ["rec", "align"]}},
        "translation without rec, align, feat",
        "without-rec-align-feat",
    ),
    (
        {"reward": "translation", "negatives": 5, "translator": {"steps": 9, "align": "dtw"}},
        "translation, aligned, negatives",
        "translation-aligned-negatives",
    ),
]


@pytest.mark.parametrize(("run", "name", "short"), RUNS)
def test_a_method_is_named_by_what_departs_from_the_papers(run, name, short):
    assert method_name(run) == name
    assert short_name(name) == short


class Family:
    """Demonstrations, translator, translation and policy, as small as they can be; any of them can be made again."""

    def __init__(self, folder, reward="translation", **demos):
        self.paths = {kind: folder / f"x.{kind}.h5" for kind in ("demos", "translator", "translation", "policy")}
        self._made = 0
        self.collect(**demos)
        self.train()
        self.translate()
        self._write("policy", {"weights/a": np.zeros(3)}, {"reward": reward, "without": []}, ["translation"])

    def collect(self, **config):
        """Demonstrations that differ from any before."""
        self._made += 1
        arrays = {"frames": np.full((2, 3, 8, 8, 3), self._made, np.uint8), "final_distance": np.zeros(2)}
        self._write("demos", arrays, config, [])

    def train(self, without=(), steps=9):
        """A translator that differs from any before."""
        self._made += 1
        arrays = {"weights/a": np.full(3, self._made), "curve/seconds": np.array([60.0, 60.0])}
        self._write("translator", arrays, {"without": list(without), "steps": steps}, ["demos"])

    def translate(self):
        """A translation that differs from any before."""
        self._made += 1
        arrays = {
            "context_frame": np.zeros((8, 8, 3), np.uint8),
            "target_features": np.full((3, 4), float(self._made)),
            "target_images": np.zeros((3, 8, 8, 3), np.uint8),
        }
        self._write("translation", arrays, {}, ["translator"])

    def describe(self):
        return describe_method(read_artifact(self.paths["policy"], "policy"))

    def _write(self, kind, arrays, config, parents):
        parents = [self.paths[parent] for parent in parents]
        write_artifact(self.paths[kind], kind, arrays, config=config, seed=0, command=f"ifo {kind}", parents=parents)


@pytest.fixture
def family(tmp_path):
    return Family(tmp_path)


def test_a_policy_is_described_by_the_files_that_it_was_made_from(family):
    found, problem = family.describe()
    assert (found["method"], found["own_context"], problem) == ("translation", False, "")
    assert found["translator"]["minutes"] == 2 and found["translator"]["without"] == []


@pytest.mark.parametrize(("context_seed", "own"), [(-1, False), (0, True), (3, True)])
def test_demonstrations_in_one_learners_context_are_told(tmp_path, context_seed, own):
    found, problem = Family(tmp_path, "gail", context_seed=context_seed).describe()
    assert (found["own_context"], problem) == (own, "")
    assert found["method"] == ("gail, own context" if own else "gail")


def test_a_translator_that_was_trained_again_is_not_the_policys(family):
    family.train(without=["rec"])
    found, problem = family.describe()
    assert found["method"] == "translation (translator unknown)"
    assert found["translator"] is None and found["own_context"] is None
    assert "x.translator.h5, which has changed since" in problem


def test_a_translation_that_was_made_again_is_not_the_policys(family):
    family.train(without=["rec"])
    family.translate()
    found, problem = family.describe()
    assert found["method"] == "translation (translator unknown)" and found["translator"] is None
    assert "x.translation.h5, which has changed since" in problem


@pytest.mark.parametrize(("reward", "named"), [("translation", "translation"), ("gail", "gail"), ("oracle", "oracle")])
def test_demonstrations_that_were_replaced_are_not_the_policys(tmp_path, reward, named):
    family = Family(tmp_path, reward)
    family.collect(context_seed=3)
    found, problem = family.describe()
    # The oracle learns the same from any demonstrations.
    assert found["method"] == named + " (demonstrations unknown)" * (reward != "oracle")
    assert found["own_context"] is None and found["translator"]["steps"] == 9
    assert "x.demos.h5, which has changed since" in problem


@pytest.mark.parametrize(
    ("kind", "unknown"),
    [("translation", "translator"), ("translator", "translator"), ("demos", "demonstrations")],
)
def test_a_file_that_is_gone_leaves_the_method_unknown(family, kind, unknown):
    family.paths[kind].unlink()
    found, problem = family.describe()
    assert found["method"] == f"translation ({unknown} unknown)"
    assert f"x.{kind}.h5, which is missing" in problem
