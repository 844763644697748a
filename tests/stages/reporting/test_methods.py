import pytest

from stages.reporting.methods import method_name

RUNS = [
    ({"reward": "gail", "own_context": True}, "gail, own context"),
    ({"reward": "oracle", "without": []}, "oracle"),
    ({"reward": "translation"}, "translation"),
    ({"reward": "translation", "translator": {"steps": 0, "without": []}}, "random"),
    ({"reward": "translation", "without": ["img"], "translator": {"steps": 9}}, "translation without img"),
    (
        {"reward": "translation", "without": ["feat"], "translator": {"steps": 9, "without": ["rec", "align"]}},
        "translation without rec, align, feat",
    ),
    (
        {"reward": "translation", "negatives": 5, "translator": {"steps": 9, "align": "dtw"}},
        "translation, aligned, negatives",
    ),
]


@pytest.mark.parametrize(("run", "name"), RUNS)
def test_a_method_is_named_by_what_departs_from_the_papers(run, name):
    assert method_name(run) == name
