"""learn-policy: reinforcement learning in the learner's context with the translation reward (Sec. V)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from artifacts import (
    Artifact,
    ArtifactError,
    UsageError,
    default_path,
    read_artifact,
    sha256_of,
    sibling,
    stem_of,
    tile_videos,
    write_mp4,
)
from stages.config.fields import one_of
from stages.config.presets import defaults
from stages.config.stages import FOREIGN_REWARDS, LOCAL_LEARNERS, NETWORK_REWARDS, PolicyConfig
from stages.config.tasks.entry import TaskDefaults
from stages.rewards.factory import Simulated, frame_reward, make_reward
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.devices import pick_device, pick_workers
from stages.runtime.outputs import Output, name_tags
from stages.runtime.run import RunOptions, StageResult, check, environment, full_config
from stages.simulation.contexts import repeat

if TYPE_CHECKING:
    from stages.environments.protocol import Environment
    from stages.environments.spec import EnvironmentSpec
    from stages.learners.policy import Policy

# How messages call the outcomes of episodes.
OUTCOMES = {
    "normalised_distance": "normalized final distance",
    "success": "success rate",
    "env_return": "return of the environment's own reward",
}


@dataclass(frozen=True)
class Place:
    """Where the learner lives: a simulated task in one context, or a Gymnasium environment.

    Attributes:
        task: Name of the simulated task; empty: a Gymnasium environment.
        own: Defaults of the task.
        described: What the policy's configuration records of the place.
        recipe: Digests of code that decides the result.
        arrays: What the policy's file holds of the place.
        outcomes: Figures of the learning curve that say how episodes ended.
        opened: Function that makes the environment to learn in, with its reward.
        film: Function that films one deterministic episode of a policy: pictures (T, H', W', 3) with captions.
    """

    task: str
    own: TaskDefaults
    described: dict[str, Any]
    recipe: dict[str, str]
    arrays: dict[str, np.ndarray]
    outcomes: tuple[str, ...]
    opened: Callable[[], AbstractContextManager[Environment]]
    film: Callable[[Policy], np.ndarray]


def learn_policy(config: PolicyConfig, run: RunOptions, translation: Path) -> StageResult:
    """Learn a policy that tracks the translation; write the `policy` artifact and a video of policy and target.

    The policy receives the learner's observation. Frames are rendered only if the reward needs them.

    Raises:
        ArtifactError: The translation has neither a simulated context nor an environment.
        UsageError: The environment fails, or has no such reward.
    """
    from stages.learners.loop import curve_arrays, learn
    from stages.learners.policy import Policy, policy_weights
    from stages.reporting.films import captioned, enlarged
    from stages.runtime.devices import use_threads
    from stages.simulation.gl import choose_backend

    check("learn-policy", config, run)
    choose_backend()
    source = read_artifact(translation, "translation")
    device = pick_device(run.device)
    workers = use_threads(pick_workers(run.workers))
    place = _place(config, source, run, workers, device)
    usual = defaults(run.preset, "learn-policy", place.task, own=place.own)
    tags = name_tags(config, usual, run, source.manifest.seed, source.config.get("preset", run.preset))
    out = run.out or default_path(source.path.parent, stem_of(source.path) + tags, "policy")
    weights = {"weights_sha256": sha256_of(config.weights)} if os.path.isfile(config.weights) else {}
    output = Output.of(out, "policy", "learn-policy", config, run, [source], place.recipe | weights)
    if kept := output.kept():
        return kept
    with place.opened() as env:
        described = full_config("learn-policy", config, run, task=place.task or None)
        described |= {"observation_size": env.observation_size, "action_size": env.action_size}
        described |= place.described
        described |= {"translation_metrics": _finite(source.group("metrics"))}
        checkpoints = Checkpoints(run, out, "learn-policy", described, [source])
        model, curve = learn(env, config, run, out, "learn-policy", checkpoints)
    target = np.clip(source["target_images"], 0, 255).round().astype(np.uint8)
    shown = {"target": captioned(enlarged(target)), "policy": place.film(Policy.of(model))}
    if "expert_frames" in source:
        shown["expert here"] = captioned(enlarged(source["expert_frames"]))
    write_mp4(sibling(out, ".mp4"), tile_videos([list(shown.values())], labels=list(shown), scale=1), fps=10)
    final = {name: curve[name][-1] for name in place.outcomes if name in curve}
    figures = ", ".join(f"{OUTCOMES[name]} {value:.3f}" for name, value in final.items())
    run.progress.say(f"policy: {figures} in the last batch")
    summary = {
        **final,
        "samples": int(curve["samples"][-1]),
        "seconds": float(sum(curve["seconds"])),
        "video": str(sibling(out, ".mp4")),
    }
    result = output.write(
        policy_weights(model) | curve_arrays(curve) | place.arrays,
        config=described,
        summary=summary,
        parents=[source],
        environment=environment(device),
    )
    checkpoints.remove()
    return result


def _place(config: PolicyConfig, source: Artifact, run: RunOptions, workers: int, device: str) -> Place:
    """The place whose context a translation was made for.

    Raises:
        ArtifactError: It has neither a simulated context nor an environment.
        UsageError: The environment has no such reward, or may not be imported.
    """
    from stages.environments.spec import EnvironmentSpec

    spec = EnvironmentSpec.of(source)
    if spec is not None:
        return _foreign(spec, config, source, run, workers, device)
    if not source.names("contexts"):
        raise ArtifactError(
            f"{source.path} was translated into the context of an image, but learning needs a place to act in: "
            "translate with --env or --context-seed instead"
        )
    return _simulated(config, source, run, workers, device)


def _simulated(config: PolicyConfig, source: Artifact, run: RunOptions, workers: int, device: str) -> Place:
    """The simulated task and context of a translation."""
    from stages.environments.simulated import Camera, SimulatedEnvironment
    from stages.reporting.films import film_task
    from stages.simulation.recorded import recorded_contexts
    from stages.simulation.registry import code_digest, make_task
    from stages.simulation.render import RenderPool

    task = make_task(source.config["task"])
    contexts = recorded_contexts(source, task)
    _check_frames(source, f"task {task.name}", (task.frames, *task.frame_size))

    @contextmanager
    def opened() -> Iterator[Environment]:
        with ExitStack() as stack:
            camera = None
            if config.reward in NETWORK_REWARDS:
                camera = stack.enter_context(closing(Camera(task, contexts, RenderPool.of(task, workers))))
            reward = make_reward(config, source, Simulated(task, contexts, camera), run.seed, device)
            yield SimulatedEnvironment(
                task,
                config.episodes,
                run.seed,
                lambda rng, n: repeat(contexts, n),
                reward,
                nthread=workers,
                camera=camera,
            )

    def film(policy: Policy) -> np.ndarray:
        return film_task(task, policy, contexts)

    context = {name: source.config[name] for name in ("context_seed", "contexts")}
    described = context | {"vary": source.config.get("vary", "")}
    arrays = {f"contexts/{name}": values for name, values in contexts.items()}
    return Place(task.name, task.defaults, described, code_digest(task), arrays, ("normalised_distance",), opened, film)


def _foreign(
    spec: EnvironmentSpec, config: PolicyConfig, source: Artifact, run: RunOptions, workers: int, device: str
) -> Place:
    """The Gymnasium environment of a translation."""
    from stages.environments.foreign import ForeignEnvironment, processes_for
    from stages.environments.making import code_digest
    from stages.environments.scene import check_first_frame
    from stages.reporting.films import film_environment
    from stages.rewards.own import OwnReward

    if config.reward not in FOREIGN_REWARDS:
        raise UsageError(
            f"--reward {config.reward} needs a simulated task, but {source.path} was translated into environment "
            f"{spec.name}: expected --reward {one_of(FOREIGN_REWARDS)}"
        )
    if config.reward == "oracle" and config.learner in LOCAL_LEARNERS:
        raise UsageError(
            f"--learner {config.learner} needs a reward with a target, and the own reward of {spec.name} has none: "
            "use --learner trpo"
        )
    _check_frames(source, spec.name, (spec.frames, *spec.size))
    ramp = "none" if config.ramp == "task" else config.ramp
    processes = processes_for(config.episodes, workers)

    @contextmanager
    def opened() -> Iterator[Environment]:
        for problem in check_first_frame(spec, source["context_frame"], source["target_images"]):
            run.progress.say(problem)
        reward: Any = OwnReward()
        if config.reward != "oracle":
            reward = frame_reward(config, source, spec.timing, ramp, run.seed, device)
        rounds = config.episodes // processes
        first = 0 if config.learner in LOCAL_LEARNERS else 1
        shown = range(0) if config.reward == "oracle" else range(first, spec.frames)
        with closing(ForeignEnvironment(spec, processes, rounds, reward, shown)) as env:
            yield env

    def film(policy: Policy) -> np.ndarray:
        return film_environment(spec, policy)

    described = {"environment": spec.described(), "processes": processes}
    recipe = code_digest(spec.name, spec.success) | {"processes": str(processes)}
    return Place("", {}, described, recipe, {}, ("success", "env_return"), opened, film)


def _check_frames(source: Artifact, name: str, wanted: tuple[int, int, int]) -> None:
    """Raise ArtifactError if a translation has other frames (T, H, W) than the task or environment called `name`."""
    found = source.describe()["target_images"][0][:3]
    if found != wanted:
        raise ArtifactError(
            f"{source.path}: translations of {found[0]} frames of {found[2]}x{found[1]} pixels do not fit {name}, "
            f"which has {wanted[0]} of {wanted[2]}x{wanted[1]}: translate again"
        )


def _finite(metrics: dict[str, np.ndarray]) -> dict[str, float]:
    """The finite metrics. A Kendall tau may be undefined."""
    return {name: float(value) for name, value in metrics.items() if np.isfinite(value)}
