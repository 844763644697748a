"""Configuration of the stages that learn by reinforcement: experts, and policies in the learner's context."""

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

# What each option of a learner is read by.
TRUST_REGION = Only("learner", ("trpo", "ppo", "gps"))
POLICY_GRADIENT = Only("learner", ("trpo", "ppo"))
NETWORKS = Only("learner", LEARNERS)
OFF_POLICY = Only("learner", ("sac",))
LOCAL = Only("learner", LOCAL_LEARNERS)
# What each option of a reward is read by.
TRACKS_IMAGES = (Only("reward", IMAGE_REWARDS), Not("without", "img"))
BLURS = (*TRACKS_IMAGES, Not("image_weight", 0.0))
PRETRAINED = (Only("reward", ("pretrained",)),)
ADVERSARIAL = (Only("reward", ADVERSARIAL_REWARDS),)


@dataclass(frozen=True)
class LearnerConfig(Config):
    """How a policy is learned by reinforcement."""

    VARIANT: ClassVar[str] = "learner"

    learner: str = option("trpo", "Learning algorithm.", LEARNERS, tag="")
    iterations: int = option(100, "Iterations, each of --episodes episodes.", low=1)
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
        "Stop early when the mean return of this many iterations is no better than that of as many before (0: never).",
        low=0,
    )
    checkpoint_every: int = option(10, "Iterations between checkpoints.", low=1)

    def check_together(self) -> None:
        """Refuse a bound of zero, under which guided policy search changes nothing.

        Raises:
            UsageError: The bound is zero.
        """
        if self.learner in LOCAL_LEARNERS and not self.kl > 0:
            raise UsageError(f"--kl 0 lets --learner {self.learner} change nothing: expected more, such as 1")


@dataclass(frozen=True)
class ExpertConfig(LearnerConfig):
    """An expert: learns the task's hand-written reward in random contexts, and sees the state and the goal."""

    contexts: str = option("paper", f"Contexts to practise in: {CONTEXTS_HELP}.", CONTEXTS, tag="")
    vary: str = option("", VARY_HELP, tag="vary-")
    test_contexts: int = option(200, "Contexts that the trained expert is tested in.", low=1)
    test_episodes: int = option(16, "Episodes per context in the test of its consistency.", low=2)

    def check_together(self) -> None:
        """See `Config.check_together`."""
        super().check_together()
        check_contexts(self.contexts, self.vary)


@dataclass(frozen=True)
class PolicyConfig(LearnerConfig):
    """Learning a policy in the learner's context (Sec. V)."""

    RUN_EFFECTS: ClassVar[Mapping[str, tuple[Condition, ...]]] = {"device": (Only("reward", NETWORK_REWARDS),)}

    learner: str = option(
        "trpo",
        "Learning algorithm. gps is the trajectory-centric learner of guided policy search: it needs far fewer "
        f"episodes, has its own defaults, and takes --reward {one_of(TRACKED_REWARDS)}; its --kl is a first value, "
        "which it adapts.",
        LEARNERS + LOCAL_LEARNERS,
        tag="",
    )
    # Wide at first: with 0.6 in place of 1.6 some runs settle in a posture that hides the arm, and never leave it.
    log_std: float = option(
        0.5, "Initial log standard deviation of the actions (trpo, ppo, gps).", effect=(TRUST_REGION,)
    )
    reward: str = option(
        "translation",
        "Reward: tracking of the translation, as in the paper (translation); the true distance (oracle); tracking of "
        "the true expert video (video), of an ImageNet network's features (pretrained) or of one demonstration's joint "
        "angles (joints), none of them translated; or a discriminator (gail, tpil).",
        REWARDS,
        tag="",
    )
    without: tuple[str, ...] = option(
        (),
        "Switch a term of --reward translation or video off (repeatable).",
        REWARD_TERMS,
        effect=(Only("reward", IMAGE_REWARDS),),
        off=(),
        tag="without-",
    )
    # R_feat alone misleads on the way to a target that is far off (results/LOG.md).
    image_weight: float = option(
        2.0,
        "w_rec, weight of R_img relative to R_feat; both are scaled to order one.",
        low=0,
        effect=TRACKS_IMAGES,
    )
    blur: float = option(
        4.0,
        "R_img also compares images blurred by a Gaussian of this standard deviation, in pixels (0: as in the paper).",
        low=0,
        high=100,
        effect=BLURS,
    )
    fine_blur: float = option(
        0.0,
        "Blur from a third of the iterations on, when the policy is near the target (gps only; 0: --blur throughout). "
        "With --starts, from when one search is left.",
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
        "Fine-tune the features on the learner's own frames every this many iterations (0: never).",
        low=0,
        effect=(Only("reward", ("translation",)), Not("without", "feat")),
        off=0,
        tag="negatives",
    )
    layer: str = option(
        "best",
        "Layer of --reward pretrained; best: the layer with the lowest held-out tracking error.",
        effect=PRETRAINED,
    )
    weights: str = option(
        "",
        "File of another ImageNet network's weights, for --reward pretrained.",
        effect=PRETRAINED,
        off="",
        metavar="PATH",
    )
    discriminator_steps: int = option(
        40, "Steps of the discriminator per iteration (gail and tpil).", low=1, effect=ADVERSARIAL
    )
    discriminator_rate: float = option(
        3e-4, "Learning rate of the discriminator (gail and tpil).", low=0, effect=ADVERSARIAL
    )
    ramp: str = option(
        "task",
        "Weight of a frame's reward over time; task: as in the paper for this task.",
        RAMPS,
        effect=(Only("reward", RAMPED_REWARDS),),
    )

    def check_together(self) -> None:
        """Refuse combinations that cannot be learned from.

        Raises:
            UsageError: The options contradict each other.
        """
        super().check_together()
        if set(self.without) >= set(REWARD_TERMS):
            raise UsageError("--without feat --without img leaves no reward to learn from: keep one of the two")
        if self.learner in LOCAL_LEARNERS:
            self._check_local()
        moving = f"--reward {self.reward}" if self.reward in ADVERSARIAL_REWARDS else ""
        moving = moving or ("--negatives" if self.negatives else "")
        if moving and (self.patience or self.learner == "sac"):
            raise UsageError(
                f"{moving} changes the reward while the policy learns: --patience would take it for a flat one, and "
                "--learner sac keeps old rewards; leave one of the two out"
            )

    def _check_local(self) -> None:
        own = f"--learner {self.learner}"
        if self.reward not in TRACKED_REWARDS:
            raise UsageError(
                f"{own} --reward {self.reward}: expected --reward {one_of(TRACKED_REWARDS)}, whose squared distances "
                "it can track"
            )
        if self.negatives:
            raise UsageError(f"--negatives changes the features that {own} has in its state: leave one of the two out")
        refines = self.fine_blur and self.reward in IMAGE_REWARDS and "img" not in self.without
        if refines and self.patience:
            raise UsageError(
                "--fine-blur changes the reward while the policy learns: --patience would take it for a flat one; give "
                "--fine-blur 0, or leave --patience out"
            )
        if self.starts > 1 and 2 * self.starts > self.iterations:
            raise UsageError(
                f"--starts {self.starts} --iterations {self.iterations}: expected at least {2 * self.starts} "
                "iterations, two for each restart"
            )
        if self.starts > 1 and self.patience:
            raise UsageError(
                f"--starts {self.starts} makes a curve of several restarts run in turn: --patience would take it for a "
                "flat one; leave one of the two out"
            )
