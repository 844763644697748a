"""Configuration of the translator's training, and of translation."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar

from artifacts.errors import UsageError
from stages.config.contexts import check_contexts
from stages.config.demonstrations import parse_crop
from stages.config.environments import SUCCESS_HELP, check_success, parse_kwargs, parse_viewpoint
from stages.config.fields import Config, Not, option
from stages.config.names import ALIGNMENTS, ARCHITECTURES, CONTEXTS, KEPT_WEIGHTS, LOSSES, SCHEDULES, SPLITS

TRAINS = Not("steps", 0)
RECONSTRUCTS = (TRAINS, Not("without", "rec"))
IN_SIMULATION = (Not("context_image"), Not("env"))
# Options that have an effect only where the learner's context is a Gymnasium environment.
OF_ENVIRONMENTS = ("env_kwargs", "env_seed", "viewpoint", "success", "episode_steps", "demonstrator")

# With fewer demonstrations than FEW, training videos are augmented, and the compact network trains for fewer steps,
# unless these options are given (results/LOG.md, "Few videos").
FEW = 512
STEPS_FOR_FEW = 2000


@dataclass(frozen=True)
class TranslatorConfig(Config):
    """Configuration of the training of the context translator (Sec. IV)."""

    VARIANT: ClassVar[str] = "arch"

    arch: str = option(
        "compact",
        "Network: a small one for CPUs (compact), the paper's for simulation (paper), or the paper's smaller one for "
        "real images (real; it has dropout, and its own default of --lambda-align).",
        ARCHITECTURES,
        tag="",
    )
    steps: int = option(
        5000,
        f"Number of optimizer steps (0: keep random weights); with fewer than {FEW} demonstrations and the compact "
        f"network, at most {STEPS_FOR_FEW} unless given.",
        low=0,
    )
    videos: int = option(
        16,
        "Videos per group and step; each is the source of one pair and the target of another.",
        low=2,
        effect=(TRAINS,),
    )
    frames: int = option(4, "Frames per video and step, at the same times in all videos.", low=1, effect=(TRAINS,))
    pairings: int = option(1, "Random pairings of the videos per step.", low=1, effect=(TRAINS,))
    groups: int = option(
        1,
        "Groups of --videos videos per step. Pairs are formed within a group; threads and processes share the groups.",
        low=1,
    )
    rec_frames: int = option(
        1, "Frames per video and step that L_rec reconstructs (0: all).", low=0, effect=RECONSTRUCTS
    )
    trans_frames: int = option(
        0,
        "Frames per video and step that L_trans decodes (0: all); L_align compares the features of all.",
        low=0,
        effect=(TRAINS, Not("without", "trans")),
        off=0,
    )
    learning_rate: float = option(1e-3, "Peak learning rate.", low=0, effect=(TRAINS,))
    schedule: str = option(
        "cosine",
        "Learning rate schedule: warm-up, then cosine decay, with gradient clipping (cosine), or constant.",
        SCHEDULES,
        effect=(TRAINS,),
    )
    weight_decay: float = option(1e-4, "Weight decay of AdamW.", low=0, effect=(TRAINS,))
    lambda_rec: float = option(1.0, "lambda_1, weight of L_rec.", low=0, effect=RECONSTRUCTS)
    lambda_align: float = option(0.1, "lambda_2, weight of L_align.", low=0, effect=(TRAINS, Not("without", "align")))
    without: tuple[str, ...] = option(
        (), "Switch off a loss (repeatable).", LOSSES, effect=(TRAINS,), off=(), tag="without-"
    )
    align: str = option(
        "none",
        "How frames of two videos are paired: at equal times (none), or by soft dynamic time warping (dtw).",
        ALIGNMENTS,
        tag="",
    )
    motion_weight: float = option(
        0.0, "Additional weight of pixels that differ from the context frame.", low=0, effect=(TRAINS,), off=0.0
    )
    # Mirrored videos are more data, but also show a different robot, whose joints bend the other way.
    mirror: bool = option(
        False, "Mirror videos at random; useful with few demonstrations.", effect=(TRAINS,), off=False
    )
    swap_colours: bool = option(
        True, "Swap green and blue at random; useful if contexts differ in color.", effect=(TRAINS,), off=False
    )
    augment: bool = option(
        False,
        "Slightly change brightness, contrast, saturation and position of training videos at random, "
        f"identically for all frames of a video (default: with fewer than {FEW} demonstrations).",
        effect=(TRAINS,),
        off=False,
    )
    ema: float = option(
        0.999, "Decay of the moving average of the weights (0: no average).", low=0, high=1, effect=(TRAINS,), off=0.0
    )
    keep: str = option(
        "best",
        "Weights to keep: of the evaluation at which held-out translations have the lowest squared error (best), or of "
        "the last step (last). They differ with few videos.",
        KEPT_WEIGHTS,
        effect=(TRAINS, Not("without", "trans")),
        off="last",
    )
    held_out: int = option(256, "Number of demonstrations held out for the metrics (at most a fifth of all).", low=2)
    evaluate_every: int = option(500, "Steps between evaluations on held-out demonstrations.", low=1, effect=(TRAINS,))
    checkpoint_every: int = option(200, "Steps between checkpoints.", low=1, effect=(TRAINS,))
    amp: bool = option(True, "Use mixed precision on CUDA.", effect=(TRAINS,))
    compile: bool = option(False, "Compile the training step with torch.compile.", effect=(TRAINS,), off=False)

    def validate(self, given: Collection[str] = ()) -> None:
        """See `Config.validate`; this method also refuses --motion-weight if no loss compares pixels."""
        super().validate(given)
        if "motion_weight" in given and self.motion_weight and {"trans", "rec"} <= set(self.without):
            raise UsageError(
                f"--motion-weight {self.motion_weight:g} has no effect with --without trans --without rec, the losses "
                "that compare pixels: keep one of them, or leave --motion-weight out"
            )

    def check_together(self) -> None:
        """Refuse a training without losses.

        Raises:
            UsageError: All three losses are switched off.
        """
        if set(self.without) >= set(LOSSES):
            raise UsageError("--without trans, rec and align leaves no loss: keep one of the three")


@dataclass(frozen=True)
class TranslateConfig(Config):
    """Configuration of the translation of demonstrations into the learner's context (Sec. V.A)."""

    n: int = option(200, "Number of demonstrations to translate and average.", low=1, names=("-n", "--n"))
    split: str = option("held-out", "Set of demonstrations to choose from.", SPLITS, tag="")
    align: str = option(
        "",
        "Temporal alignment of the translations before they are averaged (default: as in training).",
        ALIGNMENTS,
        tag="",
    )
    context_seed: int = option(0, "Seed of the learner's context.", low=0, effect=IN_SIMULATION)
    contexts: str = option(
        "",
        "Distribution of the learner's context (default: that of the demonstrations).",
        CONTEXTS,
        effect=IN_SIMULATION,
        tag="",
    )
    vary: str = option(
        "",
        "Factors that vary in the learner's context (default: those that vary in the demonstrations).",
        effect=IN_SIMULATION,
        tag="vary-",
    )
    context_image: str = option(
        "",
        "PNG of the learner's context, instead of a simulated context. Only for inspecting the translation: "
        "learn-policy needs a simulated context or an environment.",
        metavar="PATH",
    )
    env: str = option(
        "",
        "Gymnasium environment to learn in, instead of a simulated context: an ID (Reacher-v5), PACKAGE:ID where "
        "importing a package registers it, or MODULE:ATTR, a function that returns an environment. Its first image is "
        "the learner's context.",
        metavar="ID",
    )
    env_kwargs: tuple[str, ...] = option((), "Keyword argument of the environment, KEY=VALUE (repeatable).", off=())
    env_seed: int = option(
        0,
        "Seed with which the environment is reset in every episode; it selects the learner's context.",
        low=0,
        high=2**32 - 1,
    )
    viewpoint: str = option(
        "",
        "Viewpoint relative to the environment's own camera, AZIMUTH,ELEVATION,DISTANCE in degrees, degrees and as a "
        "factor; only if MuJoCo is underneath (default: the middle of the demonstrations' viewpoints if they are of "
        "this environment, else its own camera).",
        off="",
        metavar="A,E,D",
        tag="view",
    )
    success: str = option("", SUCCESS_HELP, off="", metavar="NAME")
    episode_steps: int = option(
        0,
        "Steps per episode, over which the target's frames are spread evenly (0: as in demonstrations of this "
        "environment, else the environment's own limit).",
        low=0,
        high=1_000_000,
        off=0,
        tag="steps",
    )
    demonstrator: str = option(
        "",
        "Demonstrator, as for collect-demos, that shows the task once in the learner's own context. Its video judges "
        "the translation, and is what learn-policy --reward video tracks; both are only for comparison.",
        off="",
        metavar="NAME",
    )
    untranslated: bool = option(
        False,
        "Track the demonstrations as they are, from their own viewpoints, without translating them: a baseline. With "
        "-n 1, the target is a single video.",
        off=False,
        tag="untranslated",
    )
    crop: str = option(
        "",
        "Part of the image of --context-image or --env that is reduced to the size of the demonstrations' frames, "
        "X,Y,W,H in pixels (default: as in demonstrations of this environment, else all of it).",
        metavar="X,Y,W,H",
    )

    def check_together(self) -> None:
        """See `Config.check_together`."""
        check_contexts(self.contexts, self.vary)
        if self.env and self.context_image:
            raise UsageError("--env and --context-image are two contexts of the learner: leave one of the two out")
        if self.crop:
            parse_crop(self.crop)
        parse_kwargs(self.env_kwargs)
        parse_viewpoint(self.viewpoint)
        check_success(self.success)
