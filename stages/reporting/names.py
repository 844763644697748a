"""Names of methods: one for tables and plots, and one for file names and command lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

TRANSLATOR, DEMONSTRATIONS = "translator", "demonstrations"
TRACKED = ("translation", "video")  # rewards that are computed with the translator's encoder
OWN_CONTEXT = "own context"
UNTRANSLATED = "untranslated"  # the target is a demonstration from its own viewpoint
UNTRAINED = {"translation": "random", "video": "video, untrained"}  # with a translator of random weights


def method_name(run: Mapping[str, Any]) -> str:
    """Name the method of a learning run: its reward, then what departs from the default.

    Examples: `translation`; `random` (the translator was not trained); `translation without trans` (losses of the
    translator, then terms of the reward, that were switched off); `untranslated` (the target is an untranslated
    demonstration); `translation, aligned`; `translation, negatives`; `gail, own context` (the demonstrations were
    recorded in the learner's context). Where the translator or the demonstrations are not known, the name says so:
    `translation (translator unknown)`.

    Args:
        run: What is recorded of it, as `describe_method` returns it.
    """
    name = _tracking_name(run) if run["reward"] in TRACKED else str(run["reward"])
    if needs_demonstrations(run) and own_context(run):
        name += f", {OWN_CONTEXT}"
    return marked(name, run)


def marked(name: str, run: Mapping[str, Any]) -> str:
    """A name given to a run's method, with what is unknown of the run behind it."""
    unknown = unknown_part(run)
    return f"{name} ({unknown} unknown)" if unknown else name


def short_name(method: str) -> str:
    """The same name for files and command lines: `without-rec-align` of `translation without rec, align`."""
    text = method.replace("translation without", "without").replace(OWN_CONTEXT, "own").replace(" unknown)", "-unknown")
    return "-".join(text.replace("(", "").replace(",", " ").split())


def unknown_part(run: Mapping[str, Any]) -> str:
    """What is unknown of the files that decide a run's method: `translator`, `demonstrations`, or nothing ('')."""
    if run["reward"] in TRACKED and not run.get("translator"):
        return TRANSLATOR
    return DEMONSTRATIONS if needs_demonstrations(run) and own_context(run) is None else ""


def needs_demonstrations(run: Mapping[str, Any]) -> bool:
    """Whether what is learned depends on the demonstrations."""
    return bool(run["reward"] != "oracle")


def own_context(run: Mapping[str, Any]) -> bool | None:
    """Whether the demonstrations were recorded in the learner's context; None: not known."""
    # Older evaluations record no such thing; where they know the translator, there was no such option.
    found = run.get("own_context", False if run.get("translator") else None)
    return None if found is None else bool(found)


def _tracking_name(run: Mapping[str, Any]) -> str:
    reward, translator = str(run["reward"]), run.get("translator") or {}
    if reward == "translation" and run.get("untranslated"):
        reward = UNTRANSLATED + (f" mean of {run['untranslated']}" if run["untranslated"] > 1 else "")
    if translator.get("steps") == 0:
        return UNTRAINED.get(reward, f"{reward}, untrained")
    off = [*(translator.get("without") or ()), *(run.get("without") or ())]
    on = ["aligned"] * (translator.get("align") == "dtw") + ["negatives"] * bool(run.get("negatives"))
    return ", ".join([reward + (f" without {', '.join(off)}" if off else ""), *on])
