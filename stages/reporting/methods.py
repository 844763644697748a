"""How a policy was learned, read from the files that it was made from, as long as these are unchanged."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from artifacts import Artifact, ArtifactError
from stages.reporting.names import method_name

ALWAYS = ("learner", "iterations", "episodes", "starts")  # options of learn-policy that matter to every reward
_TRACKING = ("without", "ramp", "image_weight", "blur", "fine_blur", "negatives")
_DISCRIMINATOR = ("discriminator_steps", "discriminator_rate")
# Options of learn-policy that matter to one reward.
OF_REWARD = {
    "translation": _TRACKING,
    "video": _TRACKING,
    "pretrained": ("ramp", "layer", "weights"),
    "joints": ("ramp",),
    "gail": _DISCRIMINATOR,
    "tpil": _DISCRIMINATOR,
}
LEARNING = tuple(dict.fromkeys(("reward", *ALWAYS, *(name for names in OF_REWARD.values() for name in names))))
TRANSLATOR = ("arch", "steps", "without", "align", "lambda_rec", "lambda_align", "demonstrations")


def describe_method(policy: Artifact) -> tuple[dict[str, Any], str]:
    """What decides how a policy was learned.

    A file behind the policy counts only if it is the very one that the policy was made from.

    Returns:
        JSON-ready values: options of learn-policy by name; `translator`, options of the translator behind the policy's
        translation, with the `minutes` that its training took, None if not known; `untranslated`, of how many
        untranslated demonstrations the target is the mean, 0 if it is translated, None if not known; `own_context`,
        whether the demonstrations were recorded in one learner's context, None if not known; `method`, a name of all
        this. And why something is not known, in one line; empty if all is known.
    """
    described, problem = of_policy(policy.config), ""
    try:
        translation = policy.parent("translation", check=True)
        described |= of_translation(translation.config)
        translator = translation.parent("translator", check=True)
        minutes = float(translator["curve/seconds"].sum() / 60) if "curve/seconds" in translator else None
        described |= of_translator(translator.config, minutes)
        described |= of_demos(translator.parent("demos", check=True).config)
    except ArtifactError as error:
        problem = str(error)
    return {**described, "method": method_name(described)}, problem


def of_policy(config: Mapping[str, Any]) -> dict[str, Any]:
    """What the configuration of a policy says of its method; what other files would add is None."""
    unknown = {"translator": None, "own_context": None, "untranslated": None}
    return {name: config.get(name) for name in LEARNING} | unknown


def of_translation(config: Mapping[str, Any]) -> dict[str, Any]:
    """What the configuration of a policy's translation adds."""
    return {"untranslated": config["n"] if config.get("untranslated") else 0}


def of_translator(config: Mapping[str, Any], minutes: float | None = None) -> dict[str, Any]:
    """What the configuration of the translator adds, with the minutes that its training took."""
    base = {"base": config["base"]} if "base" in config else {}
    return {"translator": {**{name: config.get(name) for name in TRANSLATOR}, "minutes": minutes, **base}}


def of_demos(config: Mapping[str, Any]) -> dict[str, Any]:
    """What the configuration of the demonstrations adds."""
    return {"own_context": config.get("context_seed", -1) >= 0}
