"""Construction of the reward for learn-policy; its inputs are found through the lineage of the translation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from artifacts import Artifact, ArtifactError
from stages.config.stages import PolicyConfig
from stages.environments.timing import Timing
from stages.runtime.seeding import generator
from stages.simulation.contexts import Contexts, repeat
from stages.simulation.task import Task

if TYPE_CHECKING:
    from stages.environments.simulated import Camera
    from stages.rewards.adversarial import Schedule
    from stages.rewards.tracking import TrackingTarget
    from stages.simulation.render import RenderPool
    from stages.translation.networks import Translator

EXPERTS = 1024  # maximum number of demonstrations for a discriminator
TRACKED = 128  # maximum number of demonstrations whose pretrained features are averaged
EXAMPLES = 32  # number of these demonstrations used for the principal components for guided policy search
COMPONENTS = 100  # maximum number of principal components, as in the paper (Sec. VI.D.1)
UNSKILLED = 256  # number of videos of random actions for TPIL


@dataclass(frozen=True)
class Simulated:
    """The simulated task that a learner lives in, for the rewards that are defined by its simulator.

    Attributes:
        task: The task.
        contexts: The learner's context (leading axis 1).
        camera: Renders frames; None: the reward sees none.
    """

    task: Task
    contexts: Contexts
    camera: Camera | None = None

    @property
    def timing(self) -> Timing:
        """When episodes of the task show frames."""
        return Timing.regular(self.task.control_steps, self.task.frame_every)


def make_reward(config: PolicyConfig, source: Artifact, simulated: Simulated, seed: int, device: str) -> Any:
    """Make the reward selected by `config`.

    Args:
        config: Configuration of learn-policy.
        source: The translation.
        simulated: The learner's task and context.
        seed: Seed of the run.
        device: Torch device.

    Raises:
        ArtifactError: An input of the reward in the lineage of the translation is missing.
        PlatformError: A package that the reward needs is not installed.
        UsageError: An option of the reward is invalid.
    """
    from stages.rewards.joints import JointsReward
    from stages.rewards.state import GoalReward, OracleReward

    task, timing = simulated.task, simulated.timing
    ramp = task.ramp if config.ramp == "task" else config.ramp
    if config.reward == "oracle" and config.learner == "gps":
        return GoalReward(task, simulated.contexts)
    if config.reward == "oracle":
        return OracleReward(task)
    if config.reward == "joints":
        return JointsReward(task, _kinesthetic(task, _demonstrations(source), seed), ramp)
    if config.reward == "tpil":
        return _third_person(config, source, simulated, seed, device)
    return frame_reward(config, source, timing, ramp, seed, device)


def frame_reward(config: PolicyConfig, source: Artifact, timing: Timing, ramp: str, seed: int, device: str) -> Any:
    """Make a reward that needs nothing but the frames that the learner's environment shows.

    Args:
        config: Configuration of learn-policy; its reward is `translation`, `video`, `pretrained` or `gail`.
        source: The translation.
        timing: When episodes show frames.
        ramp: Weighting of frames over time: `none` or `quadratic`.
        seed: Seed of the run.
        device: Torch device.

    Raises:
        ArtifactError, PlatformError, UsageError: As `make_reward`.
    """
    if config.reward == "gail":
        from stages.rewards.adversarial import GailReward

        return GailReward(timing, _videos(_demonstrations(source), EXPERTS), _schedule(config), seed, device)
    if config.reward == "pretrained":
        from stages.rewards.networks import load_network
        from stages.rewards.pretrained import PretrainedReward, embedded_track, track

        network = load_network(config.weights).to(device)
        videos = _videos(_demonstrations(source), TRACKED)
        target = track(network, videos, config.layer, device)
        if config.learner == "gps":
            from stages.rewards.projected import ProjectedTrackingReward

            tracked = embedded_track(network, videos[:EXAMPLES], target, device)
            return ProjectedTrackingReward(timing, *tracked, ramp, COMPONENTS, beyond=0)
        return PretrainedReward(timing, network, target, ramp, device)
    return _translation(config, source, timing, ramp, seed, device)


def _translation(config: PolicyConfig, source: Artifact, timing: Timing, ramp: str, seed: int, device: str) -> Any:
    """The reward for tracking the translation, or the true expert video as a perfect translation."""
    from stages.rewards.negatives import NegativeTuning
    from stages.rewards.tracking import TrackingTarget
    from stages.rewards.translation import BatchTranslationReward
    from stages.translation.networks import load_translator

    if config.reward == "video" and "expert_frames" not in source:
        remedy = "while the expert's file is available"
        if source.config.get("environment"):
            remedy = "with --demonstrator NAME and another --out"
        raise ArtifactError(
            f"{source.path} contains no video of the expert in this context, which --reward video needs; "
            f"run `ifo translate` again {remedy}"
        )
    expert = config.reward == "video"
    target = TrackingTarget.of(source, config.blur, device, expert)
    model = load_translator(source.parent("translator", check=True), device)
    if target.features.shape[1] != model.feature_size:
        raise ArtifactError(
            f"{source.path}: targets of {target.features.shape[1]} features do not fit the translator, which has "
            f"{model.feature_size}: translate again"
        )
    if config.learner == "gps":
        fine = TrackingTarget.of(source, config.fine_blur, device, expert) if config.fine_blur else None
        return _projected(config, source, timing, model, (target, fine), ramp)
    tuning = None
    if config.negatives:
        tuning = NegativeTuning(model, target, source["images"], config.negatives, seed, device)
    return BatchTranslationReward(timing, model, target, config.without, config.image_weight, ramp, device, tuning)


def _projected(
    config: PolicyConfig,
    source: Artifact,
    timing: Timing,
    model: Translator,
    targets: tuple[TrackingTarget, TrackingTarget | None],
    ramp: str,
) -> Any:
    """The tracking reward as a squared distance in a few dimensions, for guided policy search.

    Args:
        config: Configuration of learn-policy.
        source: The translation.
        timing: When episodes show frames.
        model: The translator.
        targets: Coarse target and optional fine target; only the coarse one is used without the image term.
        ramp: Weighting of frames over time.
    """
    import torch

    from stages.rewards.projected import BEYOND, ProjectedTrackingReward, embedded_translations, embedding
    from stages.translation.networks import to_images

    def track(target: TrackingTarget, beyond: float, finer: ProjectedTrackingReward | None) -> ProjectedTrackingReward:
        embed = embedding(target, config.without, config.image_weight)
        goal, examples = embedded_translations(source, embed, target)

        @torch.no_grad()
        def see(frames: np.ndarray) -> np.ndarray:
            images = to_images(torch.from_numpy(frames).to(target.features.device))
            return embed(model.encode(images), images).double().cpu().numpy()

        return ProjectedTrackingReward(timing, see, goal, examples, ramp, beyond=beyond, finer=finer)

    coarse, fine = targets
    if "img" in config.without:
        return track(coarse, 0.0, None)
    return track(coarse, BEYOND, None if fine is None else track(fine, 1.0, None))


def _schedule(config: PolicyConfig) -> Schedule:
    """The training schedule of the discriminator of GAIL or TPIL."""
    from stages.rewards.adversarial import Schedule

    return Schedule(config.discriminator_steps, config.discriminator_rate)


def _third_person(config: PolicyConfig, source: Artifact, simulated: Simulated, seed: int, device: str) -> Any:
    """The reward of TPIL, which also learns from videos of random actions in the demonstrations' contexts."""
    from stages.rewards.adversarial import TpilReward

    assert simulated.camera is not None
    demos = _demonstrations(source)
    experts = _videos(demos, EXPERTS)
    unskilled = _unskilled(simulated.task, demos, simulated.camera.pool, seed)
    return TpilReward(simulated.timing, experts, _schedule(config), seed, device, unskilled=unskilled)


def _demonstrations(source: Artifact) -> Artifact:
    """The demonstrations that a translation was made from."""
    return source.parent("translator", check=True).parent("demos", check=True)


def _videos(demos: Artifact, most: int) -> np.ndarray:
    """Videos (N, T, H, W, 3), uint8, of the first demonstrations, at most `most`."""
    return demos.read("frames", slice(most))


def _contexts_like(task: Task, demos: Artifact, rng: np.random.Generator, n: int) -> Contexts:
    """Draw `n` contexts from the distribution of the demonstrations' contexts.

    The contexts are new draws, unless all demonstrations have the same context.

    Raises:
        ArtifactError: The demonstrations were not filmed in simulated contexts.
    """
    from stages.learners.demonstrators import IMPORTED, filmed_contexts
    from stages.simulation.registry import distribution, learner_context

    if demos.config.get("stage") == IMPORTED and task.demonstrator is None:
        raise ArtifactError(f"{demos.path} was not filmed in simulated contexts; use --reward gail or translation")
    drawn_from = distribution(*filmed_contexts(demos))
    context_seed = demos.config.get("context_seed", -1)
    if context_seed >= 0:
        return repeat(learner_context(task, context_seed, drawn_from), n)
    return task.draw_contexts(rng, n, drawn_from)


def _unskilled(task: Task, demos: Artifact, pool: RenderPool, seed: int) -> np.ndarray:
    """Videos (M, T, H, W, 3), uint8, of random actions in contexts drawn as for the demonstrations."""
    from stages.simulation.batch import drawn_actions, held, rollout

    rng = generator(seed, "unskilled")
    contexts = _contexts_like(task, demos, rng, UNSKILLED)
    act = held(drawn_actions(rng, task, UNSKILLED), task)
    episodes = rollout(task, contexts, *task.draw_states(rng, contexts), act, nthread=1)
    return pool.render(task.model_fields(contexts), episodes.frame_qpos(task))


def _kinesthetic(task: Task, demos: Artifact, seed: int) -> np.ndarray:
    """Joint positions (T, nq) of one kinesthetic demonstration in a context drawn as for the demonstrations."""
    from stages.learners.demonstrators import demonstrator_of

    demonstrator = demonstrator_of(task, demos)
    return demonstrator.kinesthetic(_contexts_like(task, demos, generator(seed, "kinesthetic"), 1))
