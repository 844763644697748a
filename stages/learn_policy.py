"""learn-policy: reinforcement learning in the learner's context with the translation reward (Sec. V)."""

from __future__ import annotations

import os
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np

from artifacts import (
    Artifact,
    ArtifactError,
    default_path,
    read_artifact,
    sha256_of,
    sibling,
    stem_of,
    tile_videos,
    write_mp4,
)
from stages.config.presets import defaults
from stages.config.stages import NETWORK_REWARDS, PolicyConfig
from stages.rewards.factory import Simulated, make_reward
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.devices import pick_device, pick_workers
from stages.runtime.outputs import Output, name_tags
from stages.runtime.run import RunOptions, StageResult, check, environment, full_config
from stages.simulation.contexts import repeat
from stages.simulation.task import Task


def learn_policy(config: PolicyConfig, run: RunOptions, translation: Path) -> StageResult:
    """Learn a policy that tracks the translation; write the `policy` artifact and a video of policy and target.

    The policy receives the task's learner observation. Frames are rendered only if the reward needs them.

    Raises:
        ArtifactError: The translation has no simulated context.
    """
    from stages.environments.simulated import Camera, SimulatedEnvironment
    from stages.learners.loop import curve_arrays, learn
    from stages.learners.policy import Policy, policy_video, policy_weights
    from stages.runtime.devices import use_threads
    from stages.simulation.gl import choose_backend
    from stages.simulation.recorded import recorded_contexts
    from stages.simulation.registry import code_digest, make_task
    from stages.simulation.render import RenderPool

    check("learn-policy", config, run)
    choose_backend()
    source = load_translation(translation)
    task = make_task(source.config["task"])
    device = pick_device(run.device)
    workers = use_threads(pick_workers(run.workers))
    contexts = recorded_contexts(source, task)
    _check_frames(source, task)
    usual = defaults(run.preset, "learn-policy", task.name, own=task.defaults)
    tags = name_tags(config, usual, run, source.manifest.seed, source.config.get("preset", run.preset))
    out = run.out or default_path(source.path.parent, stem_of(source.path) + tags, "policy")
    weights = {"weights_sha256": sha256_of(config.weights)} if os.path.isfile(config.weights) else {}
    output = Output.of(out, "policy", "learn-policy", config, run, [source], code_digest(task) | weights)
    if kept := output.kept():
        return kept
    with ExitStack() as opened:
        camera = None
        if config.reward in NETWORK_REWARDS:
            camera = opened.enter_context(closing(Camera(task, contexts, RenderPool.of(task, workers))))
        reward = make_reward(config, source, Simulated(task, contexts, camera), run.seed, device)
        env = SimulatedEnvironment(
            task,
            config.episodes,
            run.seed,
            lambda rng, n: repeat(contexts, n),
            reward,
            nthread=workers,
            camera=camera,
        )
        described = full_config("learn-policy", config, run, task=task.name)
        described |= {"observation_size": env.observation_size, "action_size": task.action_size}
        described |= {"context_seed": source.config["context_seed"], "contexts": source.config["contexts"]}
        described["vary"] = source.config.get("vary", "")
        described |= {"translation_metrics": _finite(source.group("metrics"))}
        checkpoints = Checkpoints(run, out, "learn-policy", described, [source])
        model, curve = learn(env, config, run, out, "learn-policy", checkpoints)
    final = curve["normalised_distance"][-1]
    with RenderPool.of(task, 1) as pool:
        video = policy_video(task, Policy.of(model), contexts, pool)
    shown = {"target": np.clip(source["target_images"], 0, 255).round().astype(np.uint8), "policy": video}
    if "expert_frames" in source:
        shown["expert here"] = source["expert_frames"]
    write_mp4(sibling(out, ".mp4"), tile_videos([list(shown.values())], labels=list(shown)), fps=10)
    run.progress.say(f"policy: normalized final distance {final:.3f} in the last batch")
    summary = {
        "normalised_distance": final,
        "samples": int(curve["samples"][-1]),
        "seconds": float(sum(curve["seconds"])),
        "video": str(sibling(out, ".mp4")),
    }
    result = output.write(
        policy_weights(model) | curve_arrays(curve) | {f"contexts/{name}": values for name, values in contexts.items()},
        config=described,
        summary=summary,
        parents=[source],
        environment=environment(device),
    )
    checkpoints.remove()
    return result


def _check_frames(source: Artifact, task: Task) -> None:
    """Raise ArtifactError if a translation has other frames than the task."""
    found, wanted = source.describe()["target_images"][0][:3], (task.frames, *task.frame_size)
    if found != wanted:
        raise ArtifactError(
            f"{source.path}: translations of {found[0]} frames of {found[2]}x{found[1]} pixels do not fit task "
            f"{task.name}, which has {wanted[0]} of {wanted[2]}x{wanted[1]}: translate again"
        )


def _finite(metrics: dict[str, np.ndarray]) -> dict[str, float]:
    """The finite metrics. A Kendall tau may be undefined."""
    return {name: float(value) for name, value in metrics.items() if np.isfinite(value)}


def load_translation(path: Path) -> Artifact:
    """Read the translation at `path`, which must have a simulated context.

    Raises:
        ArtifactError: The translation was made for a context image, not for a simulated context.
    """
    artifact = read_artifact(path, "translation")
    if not artifact.names("contexts"):
        raise ArtifactError(
            f"{path} was translated into the context of an image, but learning needs a simulated context: "
            "translate with --context-seed instead"
        )
    return artifact
