"""Names that are the choices of options."""

from __future__ import annotations

from stages.config.tasks import ENTRIES

TASKS = tuple(task.name for task in ENTRIES.values() if not task.household and not task.name.endswith(":"))
HOUSEHOLD = tuple(task.name for task in ENTRIES.values() if task.household)
CONTEXTS = ("paper", "narrow", "fixed")
# Factors that can vary between contexts. Each task supports a subset, and by default varies what the paper varies.
FACTORS = ("azimuth", "elevation", "distance", "colour", "distractors", "goal", "initial")
ARCHITECTURES = ("compact", "paper", "real")
LOSSES = ("trans", "rec", "align")
ALIGNMENTS = ("none", "dtw")
SCHEDULES = ("cosine", "constant")
KEPT_WEIGHTS = ("best", "last")
REWARDS = ("translation", "oracle", "video", "pretrained", "gail", "tpil", "joints")
IMAGE_REWARDS = ("translation", "video")  # have the terms R_feat and R_img, for a tracked video
ADVERSARIAL_REWARDS = ("gail", "tpil")
TRACKED_REWARDS = ("translation", "video", "oracle", "joints", "pretrained")  # are squared distances, which gps needs
RAMPED_REWARDS = ("translation", "video", "joints", "pretrained")  # are weighted over time
NETWORK_REWARDS = ("translation", "video", "pretrained", "gail", "tpil")  # use networks, on --device
FOREIGN_REWARDS = ("translation", "video", "pretrained", "gail", "oracle")  # need no simulated task
REWARD_TERMS = ("feat", "img")
RAMPS = ("task", "none", "quadratic")
LEARNERS = ("trpo", "ppo", "sac")
LOCAL_LEARNERS = ("gps",)  # learn in a single context, with local models of the dynamics
SPLITS = ("held-out", "all")
EXPORT_FORMATS = ("lerobot", "robomimic", "minari")
CAMERA = "camera"
FRAME_SIDES = range(16, 513, 4)  # heights and widths of frames in pixels; the translators halve frames twice
PLAIN_FPS = 10  # as in the MP4s for inspection
