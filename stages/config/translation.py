"""Configuration of the translator's training, and of translating with it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar

from artifacts.errors import UsageError
from stages.config.contexts import check_contexts
from stages.config.fields import Config, Not, option
from stages.config.names import ALIGNMENTS, ARCHITECTURES, CONTEXTS, LOSSES, SCHEDULES, SPLITS

TRAINS = Not("steps", 0)
RECONSTRUCTS = (TRAINS, Not("without", "rec"))
IN_SIMULATION = (Not("context_image"),)


@dataclass(frozen=True)
class TranslatorConfig(Config):
    """Training of the context translator (Sec. IV)."""

    VARIANT: ClassVar[str] = "arch"

    arch: str = option(
        "compact",
        "Network: a small one for CPUs (compact), the paper's for simulation (paper), or the paper's narrow one for "
        "real images (real, with dropout and its own default of --lambda-align).",
        ARCHITECTURES,
        tag="",
    )
    steps: int = option(5000, "Optimizer steps (0: leave the weights random).", low=0)
    videos: int = option(
        16, "Videos per step; each one is source of one pair and target of another.", low=2, effect=(TRAINS,)
    )
    frames: int = option(4, "Frames of each video per step, at the same times in all of them.", low=1, effect=(TRAINS,))
    pairings: int = option(1, "Pairings of the videos per step.", low=1, effect=(TRAINS,))
    groups: int = option(
        1,
        "Groups of --videos videos per step. Pairs are made within a group; several processes share the groups.",
        low=1,
    )
    rec_frames: int = option(
        1, "Frames of each video per step that L_rec reconstructs (0: all).", low=0, effect=RECONSTRUCTS
    )
    learning_rate: float = option(1e-3, "Peak learning rate.", low=0, effect=(TRAINS,))
    schedule: str = option(
        "cosine",
        "Learning rate over time: warm-up, then a cosine, with clipped gradients (cosine), or constant.",
        SCHEDULES,
        effect=(TRAINS,),
    )
    weight_decay: float = option(1e-4, "AdamW's weight decay.", low=0, effect=(TRAINS,))
    lambda_rec: float = option(1.0, "lambda_1, weight of L_rec.", low=0, effect=RECONSTRUCTS)
    lambda_align: float = option(0.1, "lambda_2, weight of L_align.", low=0, effect=(TRAINS, Not("without", "align")))
    without: tuple[str, ...] = option(
        (), "Switch a loss off (repeatable).", LOSSES, effect=(TRAINS,), off=(), tag="without-"
    )
    align: str = option(
        "none",
        "How frames of two videos are paired: at equal times (none), or by soft dynamic time warping (dtw).",
        ALIGNMENTS,
        tag="",
    )
    motion_weight: float = option(
        0.0, "Extra weight of pixels that differ from the context frame.", low=0, effect=(TRAINS,), off=0.0
    )
    # Mirrored videos are more data, but another world to learn, too: a robot whose joints bend the other way.
    mirror: bool = option(False, "Mirror videos at random: for few demonstrations.", effect=(TRAINS,), off=False)
    swap_colours: bool = option(
        True, "Swap green and blue at random: for contexts that differ in colour.", effect=(TRAINS,), off=False
    )
    augment: bool = option(
        False,
        "Change brightness, contrast, saturation and position of training videos a little at random, the same for a "
        "whole video and its context frame: for few real videos.",
        effect=(TRAINS,),
        off=False,
    )
    ema: float = option(
        0.999, "Decay of the moving average of the weights (0: no average).", low=0, high=1, effect=(TRAINS,), off=0.0
    )
    held_out: int = option(256, "Demonstrations held out for the metrics (at most a fifth of all).", low=2)
    evaluate_every: int = option(500, "Steps between evaluations on held-out demonstrations.", low=1, effect=(TRAINS,))
    checkpoint_every: int = option(200, "Steps between checkpoints.", low=1, effect=(TRAINS,))
    amp: bool = option(True, "Mixed precision on CUDA.", effect=(TRAINS,))
    compile: bool = option(False, "Compile the training step with torch.compile.", effect=(TRAINS,), off=False)

    def validate(self, given: Collection[str] = ()) -> None:
        """See `Config.validate`; also refuses --motion-weight where no loss compares pixels."""
        super().validate(given)
        if "motion_weight" in given and self.motion_weight and {"trans", "rec"} <= set(self.without):
            raise UsageError(
                f"--motion-weight {self.motion_weight:g} has no effect with --without trans --without rec, the losses "
                "that compare pixels: keep one of them, or leave --motion-weight out"
            )

    def check_together(self) -> None:
        """Refuse a training without losses.

        Raises:
            UsageError: All three losses are off.
        """
        if set(self.without) >= set(LOSSES):
            raise UsageError("--without trans, rec and align leaves no loss to train on: keep one of the three")


@dataclass(frozen=True)
class TranslateConfig(Config):
    """Translation of demonstrations into the learner's context (Sec. V.A)."""

    n: int = option(200, "Demonstrations to translate and average.", low=1, names=("-n", "--n"))
    split: str = option("held-out", "Demonstrations to choose from.", SPLITS, tag="")
    align: str = option(
        "", "Align translations in time before they are averaged (default: as in training).", ALIGNMENTS, tag=""
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
        "What varies in the learner's context (default: what varies in the demonstrations).",
        effect=IN_SIMULATION,
        tag="vary-",
    )
    context_image: str = option(
        "",
        "PNG of the learner's context, in place of a simulated one. For a look at the translation only: learn-policy "
        "needs a simulated context.",
        metavar="PATH",
    )

    def check_together(self) -> None:
        """See `Config.check_together`."""
        check_contexts(self.contexts, self.vary)
