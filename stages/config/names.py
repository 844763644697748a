"""Names that options choose from."""

from __future__ import annotations

from stages.config.tasks import ENTRIES

TASKS = tuple(task.name for task in ENTRIES.values() if not task.household and not task.name.endswith(":"))
HOUSEHOLD = tuple(task.name for task in ENTRIES.values() if task.household)
CONTEXTS = ("paper", "narrow", "fixed")
# What can vary between contexts. A task has its own subset of these, and varies by default what the paper varies in it.
FACTORS = ("azimuth", "elevation", "distance", "colour", "distractors", "goal", "initial")
ARCHITECTURES = ("compact", "paper", "real")
LOSSES = ("trans", "rec", "align")
ALIGNMENTS = ("none", "dtw")
SCHEDULES = ("cosine", "constant")
REWARDS = ("translation", "oracle", "video", "pretrained", "gail", "tpil", "joints")
IMAGE_REWARDS = ("translation", "video")  # R_feat and R_img of a video that is tracked
ADVERSARIAL_REWARDS = ("gail", "tpil")
TRACKED_REWARDS = ("translation", "video", "oracle", "joints", "pretrained")  # squared distances, as gps needs them
RAMPED_REWARDS = ("translation", "video", "joints", "pretrained")  # weighted over time
NETWORK_REWARDS = ("translation", "video", "pretrained", "gail", "tpil")  # compute with networks, on --device
REWARD_TERMS = ("feat", "img")
RAMPS = ("task", "none", "quadratic")
LEARNERS = ("trpo", "ppo", "sac")
LOCAL_LEARNERS = ("gps",)  # learn in a single context, from local models of the dynamics
SPLITS = ("held-out", "all")
EXPORT_FORMATS = ("lerobot", "robomimic", "minari")
CAMERA = "camera"
FRAME_SIDES = range(16, 513, 4)  # heights and widths of frames in pixels; the translators halve frames twice
PLAIN_FPS = 10  # as in the MP4s that people look at
