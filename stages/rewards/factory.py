"""The reward that learn-policy learns from; what it is made from is found through the translation's lineage."""

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

EXPERTS = 1024  # demonstrations that a discriminator sees
TRACKED = 128  # demonstrations whose pretrained features are averaged
EXAMPLES = 32  # of these, from which guided policy search's principal components are made
COMPONENTS = 100  # of them, at most, as in the paper (Sec. VI.D.1)
UNSKILLED = 256  # videos of random actions that TPIL learns from


def make_reward(
    config: PolicyConfig, task: Task, source: Artifact, contexts: Contexts, workers: int, seed: int, device: str
) -> Any:
    """The reward that `config` names, in the learner's `contexts` (leading axis 1).

    Args:
        source: The translation.

    Raises:
        ArtifactError: A file behind the translation, that the reward is made from, is missing.
        PlatformError: A package that the reward needs is missing.
        UsageError: An option of the reward makes no sense.
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
    """Tracking of the translation, or of the true expert's video as a perfect one."""
    from stages.rewards.negatives import NegativeTuning
    from stages.rewards.tracking import TrackingTarget
    from stages.rewards.translation import BatchTranslationReward
    from stages.translation.networks import load_translator

    if config.reward == "video" and "expert_frames" not in source:
        raise ArtifactError(
            f"{source.path} holds no video of the expert in this context, expected one for --reward video; "
            "translate again where the demonstrations' expert is at hand"
        )
    expert = config.reward == "video"
    target = TrackingTarget.of(source, config.blur, device, expert)
    model = load_translator(source.parent("translator", check=True), device)
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
    """The tracking as a squared distance of some few numbers, for guided policy search.

    Args:
        targets: The coarse target, and the fine one, if there is one; without images there is nothing to blur.
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
    """GAIL's reward or TPIL's."""
    from stages.rewards.adversarial import GailReward, Schedule, TpilReward

    demos = _demonstrations(source)
    schedule = Schedule(config.discriminator_steps, config.discriminator_rate)
    experts = _videos(demos, EXPERTS)
    drawing = pool()  # Not before what may be missing has been read: it starts processes.
    given = (task, contexts, drawing, experts, schedule, seed, device)
    if config.reward == "gail":
        return GailReward(*given)
    return TpilReward(*given, unskilled=_unskilled(task, demos, drawing, seed))


def _demonstrations(source: Artifact) -> Artifact:
    """The demonstrations behind a translation."""
    return source.parent("translator", check=True).parent("demos", check=True)


def _videos(demos: Artifact, most: int) -> np.ndarray:
    """Demonstrations (N, T, H, W, 3), uint8: the first ones, `most` at most."""
    return demos.read("frames", slice(most))


def _contexts_like(task: Task, demos: Artifact, rng: np.random.Generator, n: int) -> Contexts:
    """`n` contexts drawn as those of the demonstrations were; none of them is one of theirs, unless all have the same.

    Raises:
        ArtifactError: They were not filmed in simulated contexts.
    """
    from stages.learners.demonstrators import IMPORTED, filmed_contexts
    from stages.simulation.registry import distribution, learner_context

    if demos.config.get("stage") == IMPORTED and task.demonstrator is None:
        raise ArtifactError(f"{demos.path} was not filmed in simulated contexts: give --reward gail or translation")
    drawn_from = distribution(*filmed_contexts(demos))
    context_seed = demos.config.get("context_seed", -1)
    if context_seed >= 0:
        return repeat(learner_context(task, context_seed, drawn_from), n)
    return task.draw_contexts(rng, n, drawn_from)


def _unskilled(task: Task, demos: Artifact, pool: RenderPool, seed: int) -> np.ndarray:
    """Videos (M, T, H, W, 3), uint8, of random actions in contexts like the demonstrations'."""
    from stages.simulation.batch import drawn_actions, held, rollout

    rng = generator(seed, "unskilled")
    contexts = _contexts_like(task, demos, rng, UNSKILLED)
    act = held(drawn_actions(rng, task, UNSKILLED), task)
    episodes = rollout(task, contexts, *task.draw_states(rng, contexts), act, nthread=1)
    return pool.render(task.model_fields(contexts), episodes.frame_qpos(task))


def _kinesthetic(task: Task, demos: Artifact, seed: int) -> np.ndarray:
    """Joint positions (T, nq) of one demonstration in a context like the demonstrations'."""
    from stages.learners.demonstrators import demonstrator_of

    demonstrator = demonstrator_of(task, demos)
    return demonstrator.kinesthetic(_contexts_like(task, demos, generator(seed, "kinesthetic"), 1))
