"""train-translator says when its features lead nowhere, and what may help."""

import pytest

from stages.config.stages import TranslatorConfig
from stages.train_translator import _advice


@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.999])
def test_features_that_lead_to_the_goal_need_no_advice(ratio):
    assert _advice({"feature_ratio": ratio}, TranslatorConfig(), 20, fine_tuned=False) == ""


def test_what_is_already_done_is_not_advised():
    bare = _advice({"feature_ratio": 1.0}, TranslatorConfig(steps=600), 20, fine_tuned=False)
    assert "its feature ratio is 1.00" in bare
    assert "more than 600 steps (--steps), more than 20 demonstrations, --augment, --from with" in bare
    done = _advice({"feature_ratio": 1.7}, TranslatorConfig(augment=True), 20, fine_tuned=True)
    assert "--augment" not in done and "--from" not in done and "narrower" in done
    assert "\n" not in done
