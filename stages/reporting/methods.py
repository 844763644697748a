"""What a learning run is called in tables and plots: its reward, and what was switched off or on."""

from __future__ import annotations

from typing import Any

from artifacts import Artifact, ArtifactError

LEARNING = (
    *("reward", "learner", "without", "ramp", "image_weight", "blur", "fine_blur", "negatives"),
    *("iterations", "episodes", "starts"),
)
TRANSLATOR = ("arch", "steps", "without", "align", "lambda_rec", "lambda_align", "demonstrations")


def describe_method(policy: Artifact) -> dict[str, Any]:
    """What decides how a policy was learned, JSON-ready.

    Returns:
        Options of learn-policy by name; `translator`, options of the translator behind its translation, with the
        `minutes` that training took, or {} where that file is gone; `method`, a short name of all this.
    """
    described: dict[str, Any] = {name: policy.config.get(name) for name in LEARNING}
    try:
        translator = policy.parent("translation").parent("translator")
    except ArtifactError:
        described["translator"] = {}
    else:
        described["translator"] = {name: translator.config.get(name) for name in TRANSLATOR}
        described["translator"]["minutes"] = float(translator["curve/seconds"].sum() / 60)
        described["own_context"] = _own_context(translator)
    return {**described, "method": method_name(described)}


def _own_context(translator: Artifact) -> bool:
    """Whether its demonstrations were all filmed in one learner's context."""
    try:
        return translator.parent("demos").config.get("context_seed", -1) >= 0
    except ArtifactError:
        return False


def method_name(run: dict[str, Any]) -> str:
    """A run's method: its reward; for the translation reward also what departs from it.

    `translation`, `random` (a translator that was not trained), `translation without trans` (losses of the translator
    and terms of the reward that were switched off, in order), `translation, aligned`, `translation, negatives`. Behind
    all this, `own context` where the demonstrations are from the learner's.
    """
    own = ", own context" * bool(run.get("own_context"))
    if run["reward"] != "translation":
        return run["reward"] + own
    translator = run.get("translator") or {}
    if translator.get("steps") == 0:
        return "random" + own
    off = [*(translator.get("without") or ()), *(run.get("without") or ())]
    name = "translation" + (f" without {', '.join(off)}" if off else "")
    on = ["aligned"] * (translator.get("align") == "dtw") + ["negatives"] * bool(run.get("negatives"))
    return ", ".join([name, *on]) + own
