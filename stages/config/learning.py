"""Configuration of reinforcement learning: experts, and policies in the learner's context."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from artifacts.errors import UsageError
from stages.config.contexts import CONTEXTS_HELP, VARY_HELP, check_contexts
from stages.config.fields import Condition, Config, Not, Only, one_of, option
from stages.config.names import (
    ADVERSARIAL_REWARDS,
    CONTEXTS,
    IMAGE_REWARDS,
    LEARNERS,
    LOCAL_LEARNERS,
    NETWORK_REWARDS,
    RAMPED_REWARDS,
    RAMPS,
    REWARD_TERMS,
    REWARDS,
    TRACKED_REWARDS,
)

# The learners that use each option.
TRUST_REGION = Only("learner", ("trpo", "ppo", "gps"))
POLICY_GRADIENT = Only("learner", ("trpo", "ppo"))
NETWORKS = Only("learner", LEARNERS)
OFF_POLICY = Only("learner", ("sac",))
LOCAL = Only("learner", LOCAL_LEARNERS)
# The rewards that use each option.
TRACKS_IMAGES = (Only("reward", IMAGE_REWARDS), Not("without", "img"))
BLURS = (*TRACKS_IMAGES, Not("image_weight", 0.0))
PRETRAINED = (Only("reward", ("pretrained",)),)
ADVERSARIAL = (Only("reward", ADVERSARIAL_REWARDS),)


@dataclass(frozen=True)
class LearnerConfig(Config):
    """Configuration of a reinforcement learner."""

    VARIANT: ClassVar[str] = "learner"

    learner: str = option("trpo", "Learning algorithm.", LEARNERS, tag="")
    iterations: int = option(100, "Number of iterations, each with --episodes episodes.", low=1)
    episodes: int = option(
        250,
        "Episodes per iteration, run in parallel (50 control steps each; 1,000 in dm_control's suite).",
        low=2,
    )
    hidden: int = option(
        64, "Width of the two hidden layers of the policy and value networks.", low=1, effect=(NETWORKS,)
    )
    kl: float = option(
        0.02, "Bound on the mean KL divergence of an update (trpo, ppo, gps).", low=0, effect=(TRUST_REGION,)
    )
    discount: float = option(0.99, "Discount factor per control step.", low=0, high=1, effect=(NETWORKS,))
    gae_lambda: float = option(
        0.97,
        "Lambda of generalized advantage estimation (trpo, ppo).",
        low=0,
        high=1,
        effect=(POLICY_GRADIENT,),
    )
    log_std: float = option(
        -0.5, "Initial log standard deviation of the actions (trpo, ppo, gps).", effect=(TRUST_REGION,)
    )
    critic_rate: float = option(
        3e-3, "Learning rate of the value network; ppo and sac use a tenth of it.", low=0, effect=(NETWORKS,)
    )
    updates: float = option(0.04, "Gradient updates per sample (sac only).", low=0, effect=(OFF_POLICY,))
    patience: int = option(
        0,
        "Stop early if the mean return of the last this many iterations is no better than that of as many before them "
        "(0: never).",
        low=0,
    )
    checkpoint_every: int = option(10, "Iterations between checkpoints.", low=1)

    def check_together(self) -> None:
        """Refuse a KL bound of zero, with which guided policy search would not change the policy.

        Raises:
            UsageError: The bound is zero.
        """
        if self.learner in LOCAL_LEARNERS and not self.kl > 0:
            raise UsageError(
                f"--kl 0 does not let --learner {self.learner} change the policy: expected more than 0, for example 1"
            )


@dataclass(frozen=True)
class ExpertConfig(LearnerConfig):
    """Configuration of an expert, which learns from the task's own reward in random contexts and observes the goal."""

    contexts: str = option("paper", f"Distribution of training contexts: {CONTEXTS_HELP}.", CONTEXTS, tag="")
    vary: str = option("", VARY_HELP, tag="vary-")
    test_contexts: int = option(200, "Number of contexts in which the trained expert is tested.", low=1)
    test_episodes: int = option(16, "Episodes per context in the test of the expert's consistency.", low=2)

    def check_together(self) -> None:
        """See `Config.check_together`."""
        super().check_together()
        check_contexts(self.contexts, self.vary)


@dataclass(frozen=True)
class PolicyConfig(LearnerConfig):
    """Configuration of learning a policy in the learner's context (Sec. V)."""

    RUN_EFFECTS: ClassVar[Mapping[str, tuple[Condition, ...]]] = {"device": (Only("reward", NETWORK_REWARDS),)}

    learner: str = option(
        "trpo",
        "Learning algorithm. gps is the trajectory-centric learner of guided policy search: it needs far fewer "
        f"episodes, has its own defaults, and needs --reward {one_of(TRACKED_REWARDS)}; it adapts --kl, which is the "
        "initial value.",
        LEARNERS + LOCAL_LEARNERS,
        tag="",
    )
    # The initial noise is large: with a standard deviation of 0.6 instead of 1.6, some runs converge to a posture that
    # hides the arm, and never leave it.
    log_std: float = option(
        0.5, "Initial log standard deviation of the actions (trpo, ppo, gps).", effect=(TRUST_REGION,)
    )
    reward: str = option(
        "translation",
        "Reward: tracking of the translated demonstrations, as in the paper (translation); the true distance (oracle); "
        "tracking, without translation, of the true expert video (video), of an ImageNet network's features "
        "(pretrained) or of one demonstration's joint angles (joints); or a discriminator (gail, tpil).",
        REWARDS,
        tag="",
    )
    without: tuple[str, ...] = option(
        (),
        "Switch off a term of --reward translation or video (repeatable).",
        REWARD_TERMS,
        effect=(Only("reward", IMAGE_REWARDS),),
        off=(),
        tag="without-",
    )
    # R_feat without R_img is misleading when the target is far away (results/LOG.md).
    image_weight: float = option(
        2.0,
        "w_rec, the weight of R_img relative to R_feat; both are scaled to order one.",
        low=0,
        effect=TRACKS_IMAGES,
    )
    blur: float = option(
        4.0,
        "R_img also compares images blurred by a Gaussian with this standard deviation, in pixels (0: no blurred "
        "images, as in the paper).",
        low=0,
        high=100,
        effect=BLURS,
    )
    fine_blur: float = option(
        0.0,
        "Blur after a third of the iterations, when the policy is near the target, instead of --blur (gps only; 0: use "
        "--blur throughout). With --starts, it applies as soon as only one restart continues.",
        low=0,
        high=100,
        effect=(LOCAL, *BLURS),
        off=0.0,
    )
    starts: int = option(
        1,
        "Independent restarts, run in turn (gps only); after half of the iterations only the lowest-cost one "
        "continues.",
        low=1,
        effect=(LOCAL,),
        off=1,
        tag="starts",
    )
    negatives: int = option(
        0,
        "Iterations between fine-tunings of the features on the learner's own frames (0: never).",
        low=0,
        effect=(Only("reward", ("translation",)), Not("without", "feat")),
        off=0,
        tag="negatives",
    )
    layer: str = option(
        "best",
        "Layer whose features --reward pretrained tracks; best: the layer with the lowest held-out tracking error.",
        effect=PRETRAINED,
    )
    weights: str = option(
        "",
        "File with the weights of another ImageNet network, for --reward pretrained.",
        effect=PRETRAINED,
        off="",
        metavar="PATH",
    )
    discriminator_steps: int = option(
        40, "Gradient steps of the discriminator per iteration (gail and tpil).", low=1, effect=ADVERSARIAL
    )
    discriminator_rate: float = option(
        3e-4, "Learning rate of the discriminator (gail and tpil).", low=0, effect=ADVERSARIAL
    )
    ramp: str = option(
        "task",
        "Weighting of the reward over time; task: as in the paper for this task.",
        RAMPS,
        effect=(Only("reward", RAMPED_REWARDS),),
    )

    def check_together(self) -> None:
        """Refuse combinations of options that make learning impossible.

        Raises:
            UsageError: The options contradict each other.
        """
        super().check_together()
        if set(self.without) >= set(REWARD_TERMS):
            raise UsageError("--without feat --without img leaves no reward: keep one of the two terms")
        if self.learner in LOCAL_LEARNERS:
            self._check_local()
        moving = f"--reward {self.reward}" if self.reward in ADVERSARIAL_REWARDS else ""
        moving = moving or ("--negatives" if self.negatives else "")
        if moving and (self.patience or self.learner == "sac"):
            raise UsageError(
                f"{moving} changes the reward while the policy learns: --patience would stop too early, and --learner "
                "sac would keep old rewards; leave one of the two out"
            )

    def _check_local(self) -> None:
        own = f"--learner {self.learner}"
        if self.reward not in TRACKED_REWARDS:
            raise UsageError(
                f"{own} --reward {self.reward}: expected --reward {one_of(TRACKED_REWARDS)}, which are squared "
                "distances"
            )
        if self.negatives:
            raise UsageError(f"--negatives changes the features in the state of {own}: leave one of the two out")
        refines = self.fine_blur and self.reward in IMAGE_REWARDS and "img" not in self.without
        if refines and self.patience:
            raise UsageError(
                "--fine-blur changes the reward while the policy learns: --patience would stop too early; give "
                "--fine-blur 0, or leave --patience out"
            )
        if self.starts > 1 and 2 * self.starts > self.iterations:
            raise UsageError(
                f"--starts {self.starts} --iterations {self.iterations}: expected at least {2 * self.starts} "
                "iterations, two for each restart"
            )
        if self.starts > 1 and self.patience:
            raise UsageError(
                f"--starts {self.starts} runs several restarts in turn, which share one learning curve: --patience "
                "would stop too early; leave one of the two out"
            )
