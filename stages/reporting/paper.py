"""What the paper reports of its own runs (Liu et al. 2018, Section VI): success rates by task and method."""

from __future__ import annotations

# (task, method as `stages.reporting.names` names it) -> success rate.
SUCCESS = {
    ("reach", "oracle"): 0.90,
    ("reach", "translation"): 0.85,
    ("reach", "pretrained"): 0.25,
    ("reach", "tpil"): 0.0,
    ("reach", "gail"): 0.0,
    ("push", "oracle"): 0.90,
    ("push", "translation"): 0.85,
    ("push", "pretrained"): 0.0,
    ("push", "tpil"): 0.0,
    ("push", "gail"): 0.0,
    ("sweep", "oracle"): 1.0,
    ("sweep", "translation"): 1.0,
    ("sweep", "pretrained"): 0.70,
    ("sweep", "tpil"): 0.0,
    ("sweep", "gail"): 0.0,
    ("strike", "oracle"): 1.0,
    ("strike", "translation"): 0.95,
    ("strike", "pretrained"): 0.05,
    ("strike", "tpil"): 0.0,
    ("strike", "gail"): 0.0,
    # Ablations: terms of the reward, then losses of the translator.
    ("reach", "translation without feat"): 0.55,
    ("reach", "translation without img"): 0.75,
    ("reach", "translation without trans"): 0.55,
    ("reach", "translation without rec"): 0.45,
    ("reach", "translation without rec, align"): 0.55,
    ("push", "translation without feat"): 0.60,
    ("push", "translation without img"): 0.40,
}
# Its robot (Section VI.D): (task, method) -> success rate of push-real, mean fraction that is done of the other tasks.
ROBOT = {
    ("push-real", "translation"): 0.96,
    ("push-real", "pretrained"): 0.25,
    ("push-real", "joints"): 0.0,
    ("sweep-paper", "translation"): 1.0,
    ("sweep-paper", "pretrained"): 0.0,
    ("sweep-paper", "joints"): 1.0,
    ("sweep-almonds", "translation"): 0.747,
    ("sweep-almonds", "pretrained"): 0.621,
    ("sweep-almonds", "joints"): 0.673,
    ("ladle-almonds", "translation"): 0.6625,
    ("ladle-almonds", "pretrained"): 0.175,
    ("ladle-almonds", "joints"): 0.106,
}
