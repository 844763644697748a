"""learn-policy: reinforcement learning in the learner's context, on the translation's reward (Sec. V)."""

from __future__ import annotations

from pathlib import Path

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
from stages.config.presets import defaults
from stages.config.stages import LOCAL_LEARNERS, REWARD_TERMS, TRACKED_REWARDS, PolicyConfig
from stages.rewards.factory import make_reward
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.devices import pick_device, pick_workers
from stages.runtime.outputs import Output, name_tags
from stages.runtime.run import RunOptions, StageResult, environment, full_config
from stages.simulation.contexts import repeat


def learn_policy(config: PolicyConfig, run: RunOptions, translation: Path) -> StageResult:
    """Learn a policy that tracks the translation; write the `policy` artifact and a video beside its target.

    The policy sees what the task lets a learner see. Frames are drawn only where the reward needs them.
    """
    from stages.learners.environment import EpisodeEnv
    from stages.learners.loop import curve_arrays, learn
    from stages.learners.policy import Policy, policy_video, policy_weights
    from stages.runtime.devices import use_threads
    from stages.simulation.gl import choose_backend
    from stages.simulation.registry import code_digest, make_task
    from stages.simulation.render import RenderPool

    _check(config)
    choose_backend()
    source = load_translation(translation)
    task = make_task(source.config["task"])
    device = pick_device(run.device)
    workers = use_threads(pick_workers(run.workers))
    contexts = source.group("contexts")
    usual = defaults(run.preset, "learn-policy", source.config["task"])
    tags = name_tags(config, usual, run, source.manifest.seed, source.config.get("preset", run.preset))
    out = run.out or default_path(source.path.parent, stem_of(source.path) + tags, "policy")
    weights = {"weights_sha256": sha256_of(config.weights)} if Path(config.weights).is_file() else {}
    output = Output.of(out, "policy", "learn-policy", config, run, [source], code_digest(task) | weights)
    if kept := output.kept():
        return kept
    reward = make_reward(config, task, source, contexts, workers, run.seed, device)
    try:
        env = EpisodeEnv(task, config.episodes, run.seed, lambda rng, n: repeat(contexts, n), reward, nthread=workers)
        described = full_config("learn-policy", config, run, task=task.name)
        described |= {"observation_size": env.observation_size, "action_size": task.action_size}
        described |= {"context_seed": source.config["context_seed"], "contexts": source.config["contexts"]}
        described["vary"] = source.config.get("vary", "")
        described |= {"translation_metrics": _finite(source.group("metrics"))}
        checkpoints = Checkpoints(run, out, "learn-policy", described, [source.path])
        model, curve = learn(env, config, run, out, "learn-policy", checkpoints)
    finally:
        reward.close()
    final = curve["normalised_distance"][-1]
    with RenderPool.of(task, 1) as pool:
        video = policy_video(task, Policy.of(model), contexts, pool)
    shown = {"target": np.clip(source["target_images"], 0, 255).round().astype(np.uint8), "policy": video}
    if "expert_frames" in source:
        shown["expert here"] = source["expert_frames"]
    write_mp4(sibling(out, ".mp4"), tile_videos([list(shown.values())], labels=list(shown)), fps=10)
    run.progress.say(f"policy: last batch ends at {final:.3f} of the initial distance")
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
        parents=[source.path],
        environment=environment(device),
    )
    checkpoints.remove()
    return result


def _check(config: PolicyConfig) -> None:
    """Refuse options that do not go together.

    Raises:
        UsageError: Some do not.
    """
    if config.without and config.reward not in ("translation", "video"):
        raise UsageError(
            f"--without {config.without[0]}: expected --reward translation or video, which has such a term"
        )
    if config.reward != "pretrained" and (config.weights or config.layer != PolicyConfig.layer):
        given = f"--weights {config.weights}" if config.weights else f"--layer {config.layer}"
        raise UsageError(f"{given} --reward {config.reward}: expected --reward pretrained, whose network that is")
    if set(config.without) >= set(REWARD_TERMS):
        raise UsageError("--without feat --without img leaves no reward to learn from: keep one of the two")
    if config.negatives and (config.reward != "translation" or "feat" in config.without):
        raise UsageError("--negatives tunes the features of --reward translation: use it with them, or leave it out")
    if config.learner in LOCAL_LEARNERS and config.reward not in TRACKED_REWARDS:
        raise UsageError(
            f"--learner {config.learner} --reward {config.reward}: expected --reward {', '.join(TRACKED_REWARDS)}, "
            "whose squared distances it can track"
        )
    if config.negatives and config.learner in LOCAL_LEARNERS:
        raise UsageError(
            f"--negatives changes the features that --learner {config.learner} has in its state: leave one of the two "
            "out"
        )
    if config.fine_blur and config.learner not in LOCAL_LEARNERS:
        raise UsageError(
            f"--fine-blur {config.fine_blur:g} --learner {config.learner}: expected --learner gps, which alone has a "
            "finer target; leave --fine-blur out"
        )
    refines = config.fine_blur and config.reward in ("translation", "video") and "img" not in config.without
    if refines and config.patience:
        raise UsageError(
            "--fine-blur changes the reward on the way: --patience would take it for a flat one; give --fine-blur 0, "
            "or leave --patience out"
        )
    if config.starts > 1:
        _check_starts(config)
    learns = "--negatives" if config.negatives else f"--reward {config.reward}"
    if (config.negatives or config.reward in ("gail", "tpil")) and (config.patience or config.learner == "sac"):
        raise UsageError(
            f"{learns} changes the reward on the way: --patience would take it for a flat one, and --learner sac "
            "keeps old rewards; leave one of the two out"
        )


def _check_starts(config: PolicyConfig) -> None:
    given = f"--starts {config.starts}"
    if config.learner not in LOCAL_LEARNERS:
        raise UsageError(f"{given} --learner {config.learner}: expected --learner gps, whose searches are local ones")
    if 2 * config.starts > config.iterations:
        raise UsageError(
            f"{given} --iterations {config.iterations}: expected at least {2 * config.starts} iterations, two for each"
        )
    if config.patience:
        raise UsageError(
            f"{given} makes a curve of several searches that take turns: --patience would take it for a flat one; "
            "leave one of the two out"
        )


def _finite(metrics: dict[str, np.ndarray]) -> dict[str, float]:
    """The metrics that are numbers: a tau may be undefined."""
    return {name: float(value) for name, value in metrics.items() if np.isfinite(value)}


def load_translation(path: Path) -> Artifact:
    """The translation at `path`, with a simulated context to learn in.

    Raises:
        ArtifactError: It was made from an image, not from a simulated context.
    """
    artifact = read_artifact(path, "translation")
    if not artifact.names("contexts"):
        raise ArtifactError(
            f"{path} was translated into the context of an image, expected a simulated context to learn in; "
            "translate with --context-seed instead"
        )
    return artifact
