"""Construction of the reward for learn-policy; its inputs are found through the lineage of the translation."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from artifacts import Artifact, ArtifactError
from stages.config.stages import PolicyConfig
from stages.runtime.seeding import generator
from stages.simulation.contexts import Contexts, repeat
from stages.simulation.task import Task

if TYPE_CHECKING:
    from stages.rewards.tracking import TrackingTarget
    from stages.simulation.render import RenderPool
    from stages.translation.networks import Translator

EXPERTS = 1024  # maximum number of demonstrations for a discriminator
TRACKED = 128  # maximum number of demonstrations whose pretrained features are averaged
EXAMPLES = 32  # number of these demonstrations used for the principal components for guided policy search
COMPONENTS = 100  # maximum number of principal components, as in the paper (Sec. VI.D.1)
UNSKILLED = 256  # number of videos of random actions for TPIL


def make_reward(
    config: PolicyConfig, task: Task, source: Artifact, contexts: Contexts, workers: int, seed: int, device: str
) -> Any:
    """Make the reward selected by `config` in the learner's `contexts` (leading axis 1).

    Args:
        config: Configuration of learn-policy.
        task: The learner's task.
        source: The translation.
        contexts: The learner's context.
        workers: Number of render processes.
        seed: Seed of the run.
        device: Torch device.

    Raises:
        ArtifactError: An input of the reward in the lineage of the translation is missing.
        PlatformError: A package that the reward needs is not installed.
        UsageError: An option of the reward is invalid.
    """
    from stages.rewards.joints import JointsReward
    from stages.rewards.state import GoalReward, OracleReward
    from stages.simulation.render import RenderPool

    ramp = task.ramp if config.ramp == "task" else config.ramp
    if config.reward == "oracle" and config.learner == "gps":
        return GoalReward(task, contexts)
    if config.reward == "oracle":
        return OracleReward(task)
    if config.reward == "joints":
        return JointsReward(task, _kinesthetic(task, _demonstrations(source), seed), ramp)

    def pool() -> RenderPool:
        return RenderPool.of(task, workers)

    if config.reward in ("gail", "tpil"):
        return _adversarial(config, task, source, contexts, pool, seed, device)
    if config.reward == "pretrained":
        from stages.rewards.networks import load_network
        from stages.rewards.pretrained import PretrainedReward, embedded_track, track

        network = load_network(config.weights).to(device)
        videos = _videos(_demonstrations(source), TRACKED)
        target = track(network, videos, config.layer, device)
        if config.learner == "gps":
            from stages.rewards.projected import ProjectedTrackingReward

            tracked = embedded_track(network, videos[:EXAMPLES], target, device)
            return ProjectedTrackingReward(task, contexts, pool(), *tracked, ramp, COMPONENTS, beyond=0)
        return PretrainedReward(task, contexts, pool(), network, target, ramp, device)
    return _translation(config, task, source, contexts, pool, seed, device, ramp)


def _translation(
    config: PolicyConfig,
    task: Task,
    source: Artifact,
    contexts: Contexts,
    pool: Any,
    seed: int,
    device: str,
    ramp: str,
) -> Any:
    """The reward for tracking the translation, or the true expert video as a perfect translation."""
    from stages.rewards.negatives import NegativeTuning
    from stages.rewards.tracking import TrackingTarget
    from stages.rewards.translation import BatchTranslationReward
    from stages.translation.networks import load_translator

    if config.reward == "video" and "expert_frames" not in source:
        raise ArtifactError(
            f"{source.path} contains no video of the expert in this context, which --reward video needs; "
            "run `ifo translate` again while the expert's file is available"
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
        return _projected(config, task, source, contexts, pool(), model, (target, fine), ramp)
    tuning = None
    if config.negatives:
        tuning = NegativeTuning(model, target, source["images"], config.negatives, seed, device)
    return BatchTranslationReward(
        task, contexts, model, target, pool(), config.without, config.image_weight, ramp, device, tuning
    )


def _projected(
    config: PolicyConfig,
    task: Task,
    source: Artifact,
    contexts: Contexts,
    pool: RenderPool,
    model: Translator,
    targets: tuple[TrackingTarget, TrackingTarget | None],
    ramp: str,
) -> Any:
    """The tracking reward as a squared distance in a few dimensions, for guided policy search.

    Args:
        config: Configuration of learn-policy.
        task: The learner's task.
        source: The translation.
        contexts: The learner's context (leading axis 1).
        pool: Render processes of the task.
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

        return ProjectedTrackingReward(task, contexts, pool, see, goal, examples, ramp, beyond=beyond, finer=finer)

    coarse, fine = targets
    if "img" in config.without:
        return track(coarse, 0.0, None)
    return track(coarse, BEYOND, None if fine is None else track(fine, 1.0, None))


def _adversarial(
    config: PolicyConfig,
    task: Task,
    source: Artifact,
    contexts: Contexts,
    pool: Callable[[], RenderPool],
    seed: int,
    device: str,
) -> Any:
    """The reward of GAIL or TPIL."""
    from stages.rewards.adversarial import GailReward, Schedule, TpilReward

    demos = _demonstrations(source)
    schedule = Schedule(config.discriminator_steps, config.discriminator_rate)
    experts = _videos(demos, EXPERTS)
    drawing = pool()  # Starts processes, so all files that may be missing are read first.
    given = (task, contexts, drawing, experts, schedule, seed, device)
    if config.reward == "gail":
        return GailReward(*given)
    return TpilReward(*given, unskilled=_unskilled(task, demos, drawing, seed))


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
