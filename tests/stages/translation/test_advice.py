"""train-translator says when its features lead nowhere, and what may help; it trains differently on few videos."""

import pytest

from stages.config.stages import TranslatorConfig
from stages.config.translation import FEW, STEPS_FOR_FEW
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions
from stages.train_translator import _advice, _suited


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


def suited(demonstrations, *given, **options):
    """What few demonstrations change in a configuration."""
    config = TranslatorConfig(**options)
    run = RunOptions(given=frozenset(given), progress=Progress(quiet=True))
    suits = vars(_suited(config, run, demonstrations))
    return {name: value for name, value in suits.items() if value != vars(config)[name]}


def test_few_demonstrations_are_augmented_and_trained_on_for_fewer_steps():
    assert suited(FEW - 1) == {"augment": True, "steps": STEPS_FOR_FEW}
    assert suited(FEW) == {}


def test_what_the_user_decided_stays(capsys):
    assert suited(20, "augment") == {"steps": STEPS_FOR_FEW}
    assert suited(20, "augment", "steps") == {}
    assert suited(20, augment=True, steps=30) == {}
    assert suited(20, steps=0) == {}, "only random weights"
    assert suited(20, arch="real") == {"augment": True}, "dropout learns more slowly"


def test_it_says_so(capsys):
    _suited(TranslatorConfig(steps=30), RunOptions(given=frozenset()), 20)
    assert "20 demonstrations are few: training videos are augmented (--no-augment: not)" in capsys.readouterr().err
