"""Configuration of every stage: typed, frozen, with units; the command line's options are made from these classes.

This module imports nothing heavy, so that `ifo --help` answers at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

TASKS = ("reach", "push", "sweep", "strike")
HOUSEHOLD = ("push-real", "sweep-paper", "sweep-almonds", "ladle-almonds")
CONTEXTS = ("paper", "narrow", "fixed")
ARCHITECTURES = ("compact", "paper", "real")
LOSSES = ("trans", "rec", "align")
ALIGNMENTS = ("none", "dtw")
REWARDS = ("translation", "oracle", "video", "pretrained", "gail", "tpil", "joints")
REWARD_TERMS = ("feat", "img")
RAMPS = ("task", "none", "quadratic")
VIEWPOINTS = ": seen from all round (paper), within 40 degrees (narrow), or always the same (fixed)."
VARY = (
    "What varies from context to context, separated by commas, of azimuth, elevation, distance, colour, distractors, "
    "goal, initial (default: what the paper varies in the task)."
)
LEARNERS = ("trpo", "ppo", "sac")
LOCAL_LEARNERS = ("gps",)  # learn in one context alone, by local models
TRACKED_REWARDS = ("translation", "video", "oracle", "joints", "pretrained")  # squared distances, which they need
SPLITS = ("held-out", "all")
EXPORT_FORMATS = ("lerobot", "robomimic", "minari")
CAMERA = "camera"
PLAIN_FPS = 10  # as in the MP4s that people look at
VIDEO_CRF = 12
FRAME_SIDES = range(16, 513, 4)  # heights and widths of frames in pixels; the translators halve frames twice


def option(
    default: Any,
    text: str,
    choices: tuple[str, ...] = (),
    low: float | None = None,
    high: float | None = None,
    tag: str | None = None,
) -> Any:
    """A dataclass field that is also a command-line option: its default, help, allowed values and bounds.

    With `tag`, a value other than the usual one is part of the default file name, behind this label (may be empty).
    """
    return field(default=default, metadata={"help": text, "choices": choices, "low": low, "high": high, "tag": tag})


@dataclass(frozen=True)
class LearnerConfig:
    """How a policy is learned by reinforcement."""

    learner: str = option("trpo", "Learning algorithm.", LEARNERS, tag="")
    iterations: int = option(100, "Iterations of `episodes` episodes.", low=1)
    episodes: int = option(250, "Episodes an iteration, side by side (of 50 control steps; in the suite 1,000).", low=2)
    hidden: int = option(64, "Width of the two hidden layers of policy and value.", low=1)
    kl: float = option(0.02, "Bound on the mean KL divergence of an update.", low=0)
    discount: float = option(0.99, "Discount a control step.", low=0, high=1)
    gae_lambda: float = option(0.97, "Lambda of generalised advantage estimation.", low=0, high=1)
    log_std: float = option(-0.5, "Initial log standard deviation of the actions.")
    critic_rate: float = option(3e-3, "Learning rate of the value network.", low=0)
    updates: float = option(0.04, "Gradient updates a sample (SAC alone).", low=0)
    patience: int = option(
        0,
        "Stop early when the mean return of this many iterations is no better than that of as many before (0: never).",
        low=0,
    )
    checkpoint_every: int = option(10, "Iterations between checkpoints.", low=1)


@dataclass(frozen=True)
class ExpertConfig(LearnerConfig):
    """An expert: learns the task's hand-written reward in random contexts, seeing the state and the goal."""

    contexts: str = option("paper", "Contexts to practise in" + VIEWPOINTS, CONTEXTS, tag="")
    vary: str = option("", VARY, tag="vary-")
    test_contexts: int = option(200, "Contexts that the finished expert is tested in.", low=1)
    test_episodes: int = option(16, "Episodes a context when its consistency is measured.", low=2)


@dataclass(frozen=True)
class DemosConfig:
    """Demonstrations: videos of the expert in random contexts."""

    n: int = option(3000, "Demonstrations to collect.", low=2)
    contexts: str = option("paper", "Contexts to draw from" + VIEWPOINTS, CONTEXTS, tag="")
    vary: str = option("", VARY, tag="vary-")
    context_seed: int = option(
        -1,
        "Film all in the context that translate gives a learner for this seed (-1: each in its own).",
        low=-1,
        tag="own-context",
    )
    keep_failures: bool = option(False, "Keep demonstrations that failed.")
    jitter: float = option(
        0.0,
        "Play each video at its own tempo, which wanders by up to this share (distances stay the whole episode's).",
        low=0,
        high=1,
        tag="jitter",
    )
    videos: str = option(
        "",
        "Also write each, 5 times as high and wide, as an MP4 into this new folder: footage such as a camera's, that "
        "import-demos reads.",
    )
    crf: int = option(23, "Compression of these MP4s: x264's constant rate factor, 0 (least) to 51.", low=0, high=51)


@dataclass(frozen=True)
class TranslatorConfig:
    """Training of the context translator (Sec. IV)."""

    arch: str = option(
        "compact",
        "Network: a compact one for CPUs, the paper's for simulation (paper), or its narrow one for real images (real, "
        "with dropout and a lambda_2 of its own).",
        ARCHITECTURES,
        tag="",
    )
    steps: int = option(5000, "Optimiser steps (0: leave the weights random).", low=0)
    videos: int = option(16, "Videos a step; each is source of one pair and target of another.", low=2)
    frames: int = option(4, "Frames of each video a step, at the same times in all.", low=1)
    pairings: int = option(1, "Pairings of the videos a step.", low=1)
    groups: int = option(
        1, "Groups of `videos` a step; pairs are made within a group, and processes share the groups out.", low=1
    )
    rec_frames: int = option(1, "Frames of each video a step that L_rec reconstructs (0: all).", low=0)
    learning_rate: float = option(1e-3, "Peak learning rate.", low=0)
    schedule: str = option("cosine", "Learning-rate schedule.", ("cosine", "constant"))
    weight_decay: float = option(1e-4, "AdamW's weight decay.", low=0)
    lambda_rec: float = option(1.0, "lambda_1, weight of L_rec.", low=0)
    lambda_align: float = option(0.1, "lambda_2, weight of L_align.", low=0)
    without: tuple[str, ...] = option((), "Switch a loss off (repeatable).", LOSSES, tag="without-")
    align: str = option(
        "none",
        "What pairs frames of two videos: equal time (none), or soft dynamic time warping (dtw).",
        ALIGNMENTS,
        tag="",
    )
    motion_weight: float = option(0.0, "Extra weight of pixels that differ from the context frame.", low=0)
    # Mirrored videos are more data, but another world to learn, too: a robot whose joints bend the other way.
    mirror: bool = option(False, "Mirror videos at random: for few demonstrations.")
    swap_colours: bool = option(True, "Swap green and blue at random: for contexts that differ in colour.")
    augment: bool = option(
        False,
        "Change the light and colours of training videos a little at random, and shift them by a few pixels, each "
        "video with its context frame as a whole: for few real videos.",
    )
    ema: float = option(0.999, "Decay of the averaged weights (0: none).", low=0, high=1)
    held_out: int = option(256, "Demonstrations never trained on, for the metrics (at most a fifth).", low=2)
    evaluate_every: int = option(500, "Steps between evaluations on held-out demonstrations.", low=1)
    checkpoint_every: int = option(200, "Steps between checkpoints.", low=1)
    amp: bool = option(True, "Mixed precision on CUDA.")
    compile: bool = option(False, "Compile the training step with torch.compile.")


@dataclass(frozen=True)
class TranslateConfig:
    """Translation of demonstrations into the learner's context (Sec. V.A)."""

    n: int = option(200, "Demonstrations to translate and average.", low=1)
    split: str = option("held-out", "Demonstrations to translate.", SPLITS, tag="")
    align: str = option(
        "", "Align translations in time before averaging (default: as in training).", ALIGNMENTS, tag=""
    )
    context_seed: int = option(0, "Seed of the learner's context.", low=0)
    contexts: str = option(
        "", "Distribution of the learner's context (default: that of the demonstrations).", CONTEXTS, tag=""
    )
    vary: str = option(
        "", "What varies in the learner's context (default: what does in the demonstrations).", tag="vary-"
    )
    context_image: str = option(
        "",
        "PNG of the learner's context, in place of a simulated one (to look at: learn-policy needs a simulated one).",
    )


@dataclass(frozen=True)
class PolicyConfig(LearnerConfig):
    """Learning a policy in the learner's context (Sec. V)."""

    learner: str = option(
        "trpo",
        "Learning algorithm. gps (guided policy search's local one) needs far fewer episodes, has defaults of its own, "
        f"and takes --reward {', '.join(TRACKED_REWARDS)}; its --kl is a first value, adapted on the way.",
        LEARNERS + LOCAL_LEARNERS,
        tag="",
    )
    # Wide at first: with 0.6 in place of 1.6 some runs settle in a posture that hides the arm, and never leave it.
    log_std: float = option(0.5, "Initial log standard deviation of the actions.")
    reward: str = option(
        "translation",
        "Reward: the paper's; the true distance (oracle); tracking of the true expert video, of an ImageNet network's "
        "features or of one demonstration's joints, none of them translated; a discriminator's (gail, tpil).",
        REWARDS,
        tag="",
    )
    without: tuple[str, ...] = option((), "Switch a term of the reward off (repeatable).", REWARD_TERMS, tag="without-")
    # R_feat alone misleads on the way to a target that is far off (results/LOG.md).
    image_weight: float = option(2.0, "w_rec, weight of R_img beside R_feat, both scaled to order one.", low=0)
    blur: float = option(
        4.0,
        "R_img also compares images blurred by a Gaussian of this standard deviation, in pixels (0: as the paper).",
        low=0,
        high=100,
    )
    fine_blur: float = option(
        0.0,
        "With --learner gps, the blur from a third of the iterations on, when the target is near (0: --blur, always); "
        "with --starts, from when one search is left.",
        low=0,
        high=100,
    )
    starts: int = option(
        1,
        "With --learner gps, searches that begin apart and take turns; after half of the iterations the cheapest goes "
        "on alone.",
        low=1,
        tag="starts",
    )
    negatives: int = option(
        0,
        "Tune the features on the learner's own frames every this many iterations (0: never).",
        low=0,
        tag="negatives",
    )
    layer: str = option("best", "Layer of --reward pretrained; best: where held-out demonstrations say most.")
    weights: str = option("", "File of another ImageNet network's weights, for --reward pretrained.")
    discriminator_steps: int = option(
        40, "Steps that the discriminator of gail and tpil learns after an iteration.", low=1
    )
    discriminator_rate: float = option(3e-4, "Its learning rate.", low=0)
    ramp: str = option("task", "Weight of a frame's reward over time; task: as the paper has it.", RAMPS)


@dataclass(frozen=True)
class EvaluateConfig:
    """Evaluation of finished policies."""

    episodes: int = option(100, "Episodes a policy, deterministic and stochastic each.", low=1)


@dataclass(frozen=True)
class ImportConfig:
    """What import-demos takes of real videos. No preset changes it, so that it is no entry of STAGES.

    Attributes:
        frames: T, frames taken of each video.
        size: Their WIDTHxHEIGHT in pixels.
        start, end: The segment of each video, in seconds from its first frame; end 0: at the last frame.
        fps: Frames a second from the start, in place of an end; 0: equal times to the end.
        crop: X,Y,W,H in pixels of the upright picture; empty: the largest centred one.
        crop_file: CSV with a crop for each video.
        task: The simulated task that a robot is to learn from the videos; empty: none.
        camera: Which camera of a data set; empty: its only one.
        strict: A video that cannot be used is an error.
    """

    frames: int = 25
    size: str = "48x48"
    start: float = 0.0
    end: float = 0.0
    fps: float = 0.0
    crop: str = ""
    crop_file: str = ""
    task: str = ""
    strict: bool = False
    camera: str = ""


@dataclass(frozen=True)
class ExportConfig:
    """What export-demos writes. No preset changes it, so that it is no entry of STAGES.

    Attributes:
        format: Whose data set, one of EXPORT_FORMATS.
        camera: What the camera is called in it; empty: CAMERA.
        task: What is done, in words; empty: the demonstrations' task.
        fps: Frames a second that the data set claims; 0: what the demonstrations' times say, else PLAIN_FPS.
        video: LeRobot's pictures as H.264, in place of PNGs in its tables.
        crf: x264's constant rate factor; 0: VIDEO_CRF.
    """

    format: str
    camera: str = ""
    task: str = ""
    fps: int = 0
    video: bool = False
    crf: int = 0


STAGES: dict[str, type] = {
    "train-expert": ExpertConfig,
    "collect-demos": DemosConfig,
    "train-translator": TranslatorConfig,
    "translate": TranslateConfig,
    "learn-policy": PolicyConfig,
    "evaluate": EvaluateConfig,
}
