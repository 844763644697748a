"""Options without effect, and options that contradict each other, are refused; what nobody gave never is."""

from __future__ import annotations

import dataclasses
import itertools

import pytest

from artifacts import UsageError
from stages.config.commands import COMMANDS
from stages.config.presets import PRESETS, changed, defaults
from stages.config.stages import (
    ARCHITECTURES,
    LEARNERS,
    LOCAL_LEARNERS,
    LOSSES,
    REWARDS,
    STAGES,
    TRACKED_REWARDS,
    DemosConfig,
    ExpertConfig,
    ExportConfig,
    ImportConfig,
    PolicyConfig,
    TranslateConfig,
    TranslatorConfig,
)
from stages.config.tasks import ENTRIES

# Option -> with which of (learner, reward) it is read, from the code of stages.learners and stages.rewards.
IMAGES = ("translation", "video")
READ_BY_LEARNER = {
    "hidden": {"trpo", "ppo", "sac"},
    "discount": {"trpo", "ppo", "sac"},
    "critic_rate": {"trpo", "ppo", "sac"},
    "kl": {"trpo", "ppo", "gps"},
    "log_std": {"trpo", "ppo", "gps"},
    "gae_lambda": {"trpo", "ppo"},
    "updates": {"sac"},
    "fine_blur": {"gps"},
    "starts": {"gps"},
}
READ_BY_REWARD = {
    "without": set(IMAGES),
    "image_weight": set(IMAGES),
    "blur": set(IMAGES),
    "fine_blur": set(IMAGES),
    "negatives": {"translation"},
    "layer": {"pretrained"},
    "weights": {"pretrained"},
    "discriminator_steps": {"gail", "tpil"},
    "discriminator_rate": {"gail", "tpil"},
    "ramp": {*IMAGES, "pretrained", "joints"},
    "device": {*IMAGES, "pretrained", "gail", "tpil"},
}
GIVEN = {
    "hidden": 32,
    "discount": 0.9,
    "critic_rate": 0.01,
    "kl": 0.5,
    "log_std": 0.1,
    "gae_lambda": 0.9,
    "updates": 0.1,
    "fine_blur": 2.0,
    "starts": 2,
    "without": ("feat",),
    "image_weight": 3.0,
    "blur": 2.0,
    "negatives": 2,
    "layer": "block2",
    "weights": "other.pth",
    "discriminator_steps": 3,
    "discriminator_rate": 0.1,
    "ramp": "quadratic",
}


def refusal(config, *given):
    """The message of the refusal, or None."""
    try:
        config.validate(given)
    except UsageError as error:
        assert "\n" not in str(error)
        return str(error)
    return None


@pytest.mark.parametrize("name", [*GIVEN, "device"])
def test_an_option_of_learn_policy_is_refused_where_nothing_reads_it(name):
    for learner, reward in itertools.product(LEARNERS + LOCAL_LEARNERS, REWARDS):
        if learner == "gps" and reward not in TRACKED_REWARDS:
            continue
        values = {name: GIVEN[name]} if name in GIVEN else {}
        config = PolicyConfig(learner=learner, reward=reward, **values)
        read = learner in READ_BY_LEARNER.get(name, {learner}) and reward in READ_BY_REWARD.get(name, {reward})
        if name == "negatives" and learner in ("sac", "gps"):
            read = False  # contradicts the learner
        if reward in ("gail", "tpil") and learner == "sac":
            continue  # contradict each other, whatever is given
        message = refusal(config, name)
        assert (message is None) == read, (learner, reward, message)
        if message:
            assert f"--{name.replace('_', '-')}" in message
        if name != "negatives":
            assert refusal(config) is None, "what nobody gave is not refused"


def test_the_refusal_names_what_would_give_the_option_an_effect():
    assert refusal(PolicyConfig(reward="oracle", blur=3.0), "blur") == (
        "--blur 3 has no effect with --reward oracle: expected --reward translation or video; "
        "otherwise leave --blur out"
    )
    assert "expected --learner sac" in refusal(ExpertConfig(updates=1.0), "updates")
    message = refusal(ExpertConfig(learner="sac", kl=1.0), "kl")
    assert "expected --learner trpo or ppo;" in message, "gps is no learner of experts"
    assert refusal(PolicyConfig(without=("img",), blur=1.0), "blur", "without").endswith(
        "--blur 1 has no effect with --without img: leave one of the two out"
    )
    assert "--crf 20 has no effect without --videos" in refusal(DemosConfig(crf=20), "crf")


@pytest.mark.parametrize(
    ("config", "given", "expected"),
    [
        (PolicyConfig(image_weight=0.0, blur=1.0), ("image_weight", "blur"), "--image-weight 0"),
        (PolicyConfig(learner="gps", kl=0.0), (), "--kl 0"),
        (TranslatorConfig(without=("rec",), lambda_rec=2.0), ("without", "lambda_rec"), "--without rec"),
        (TranslatorConfig(without=("rec",), rec_frames=2), ("without", "rec_frames"), "--without rec"),
        (TranslatorConfig(without=("align",), lambda_align=2.0), ("lambda_align",), "--without align"),
        (TranslatorConfig(steps=0, learning_rate=2.0), ("steps", "learning_rate"), "--steps 0"),
        (TranslatorConfig(steps=0, mirror=True), ("steps", "mirror"), "--steps 0"),
        (TranslatorConfig(without=("trans", "rec"), motion_weight=1.0), ("motion_weight",), "--motion-weight 1"),
        (TranslatorConfig(without=LOSSES), ("without",), "no loss"),
        (TranslateConfig(context_image="x.png", context_seed=3), ("context_seed",), "--context-image x.png"),
        (TranslateConfig(context_image="x.png", vary="goal"), ("vary",), "--context-image x.png"),
        (TranslateConfig(context_image="x.png", contexts="paper"), ("contexts",), "--context-image x.png"),
        (DemosConfig(contexts="fixed", vary="azimuth"), (), "paper or narrow"),
        (DemosConfig(vary="weather"), (), "'weather'"),
        (ExportConfig(), (), "--format"),
        (ExportConfig("minari", video=True), ("video",), "--format lerobot"),
        (ExportConfig("lerobot", crf=20), ("crf",), "without --video"),
        (ExportConfig("minari", camera="top"), ("camera",), "--format lerobot or robomimic"),
        (ImportConfig(crop="0,0,9,9", crop_file="x.csv"), (), "--crop and --crop-file"),
        (ImportConfig(end=2.0, fps=3.0), (), "--end and --fps"),
        (ImportConfig(frames=1), (), "2 to 1000"),
        (ImportConfig(size="big"), (), "48x48"),
        (TranslatorConfig(learning_rate=float("inf")), (), "finite"),
        (PolicyConfig(reward="money"), (), "expected translation"),
    ],
)
def test_options_without_effect_or_sense(config, given, expected):
    message = refusal(config, *given)
    assert message is not None and expected in message


@pytest.mark.parametrize(
    ("config", "given"),
    [
        (DemosConfig(contexts="fixed", vary="goal"), ("contexts", "vary")),
        (DemosConfig(contexts="narrow", vary="goal"), ("contexts", "vary")),  # narrow is what translate inherits
        (PolicyConfig(fine_blur=0.0), ("fine_blur",)),
        (PolicyConfig(starts=1), ("starts",)),
        (PolicyConfig(learner="sac", reward="oracle", negatives=0), ("negatives",)),
        (TranslatorConfig(steps=0), ("steps", "arch", "align")),
        (ExportConfig("lerobot", video=True, crf=20), ("video", "crf")),
    ],
)
def test_options_that_have_their_effect_or_ask_for_none(config, given):
    assert refusal(config, *given) is None


@pytest.mark.parametrize("stage", STAGES)
def test_what_presets_and_tasks_bring_is_never_refused(stage):
    config_class = STAGES[stage]
    variants = {"learner": LEARNERS, "arch": ARCHITECTURES, "": ("",)}[config_class.VARIANT]
    if stage == "learn-policy":
        variants += LOCAL_LEARNERS
    for preset, task, variant in itertools.product(PRESETS, ("", *ENTRIES), variants):
        config = defaults(preset, stage, task, variant)
        if variant:
            config = dataclasses.replace(config, **{config_class.VARIANT: variant})
        for reward in TRACKED_REWARDS if stage == "learn-policy" else ("",):
            tried = dataclasses.replace(config, reward=reward) if reward else config
            assert changed(stage, tried) <= {"reward", config_class.VARIANT}
            tried.validate(changed(stage, tried))


def test_what_somebody_chose_in_python_is_told_from_what_presets_bring():
    assert changed("learn-policy", PolicyConfig(reward="oracle", blur=9.0)) == {"reward", "blur"}
    assert changed("learn-policy", PolicyConfig(fine_blur=3.0)) == {"fine_blur"}, "3 pixels are the default of gps only"
    assert changed("export-demos", ExportConfig("lerobot", crf=40)) == {"format", "crf"}


def test_stages_refuse_by_themselves(tmp_path):
    from stages.learn_policy import learn_policy
    from stages.runtime.run import RunOptions

    with pytest.raises(UsageError, match="--blur 9 has no effect with --reward oracle"):
        learn_policy(PolicyConfig(reward="oracle", blur=9.0), RunOptions(), tmp_path / "none.translation.h5")
    with pytest.raises(UsageError, match="--device banana"):
        learn_policy(PolicyConfig(), RunOptions(device="banana"), tmp_path / "none.translation.h5")


def test_every_field_has_a_help_text_and_conditions_on_fields_that_exist():
    for command in COMMANDS.values():
        for config_class in (command.config, command.shared):
            items = {item.name: item for item in dataclasses.fields(config_class)}
            for item in items.values():
                assert item.metadata["help"].endswith((".", ").")), item.name
                for condition in item.metadata["effect"]:
                    assert condition.other in items, item.name
        assert set(command.names) <= {item.name for item in dataclasses.fields(command.shared)}
