"""evaluate: measure how often, and how closely, policies reach a goal that they never observe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from artifacts import (
    Artifact,
    ArtifactError,
    UsageError,
    default_path,
    read_artifact,
    sibling,
    stem_of,
    tile_videos,
    write_mp4,
)
from artifacts.atomic import write_bytes
from artifacts.paths import real
from stages.config.stages import EvaluateConfig
from stages.reporting.figures import figures
from stages.reporting.methods import describe_method
from stages.runtime.devices import pick_workers
from stages.runtime.outputs import Output
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions, StageResult, check, environment, full_config
from stages.runtime.seeding import generator, integer
from stages.simulation.contexts import Contexts, repeat

SHOWN = 6  # policies shown in the MP4
CURVES = ("curve/samples", "curve/normalised_distance")  # learning curves copied from the policies


def evaluate(config: EvaluateConfig, run: RunOptions, policies: list[Path]) -> StageResult:
    """Evaluate policies of one task; write the `evaluation` artifact, the learning curves and a video of rollouts.

    A run succeeds by the paper's criterion if the stochastic policy's normalized final distance, averaged over
    episodes, is below the task's threshold. The success rate of the deterministic policy's episodes is reported too.
    """
    from stages.learners.policy import Policy, check_fits, first_observation, policy_video
    from stages.reporting.plots import plot_learning_curves
    from stages.runtime.devices import use_threads
    from stages.simulation.gl import choose_backend
    from stages.simulation.recorded import recorded_contexts
    from stages.simulation.registry import code_digest, make_task
    from stages.simulation.render import RenderPool

    check("evaluate", config, run)
    choose_backend()
    places = [real(path) for path in policies]
    twice = [path for path, place in zip(policies, places, strict=True) if places.count(place) > 1]
    if twice:
        raise UsageError(f"{twice[0]}: given twice: pass each policy once; duplicates narrow the intervals")
    sources = [read_artifact(path, "policy") for path in policies]
    names = sorted({source.config["task"] for source in sources})
    if len(names) > 1:
        raise ArtifactError(f"policies of different tasks ({', '.join(names)}): evaluate each task separately")
    task = make_task(names[0])
    use_threads(pick_workers(run.workers))
    name = stem_of(sources[0].path) + (f"-and-{len(sources) - 1}-more" if len(sources) > 1 else "")
    name += "" if run.seed == sources[0].manifest.seed else f"-s{run.seed}"
    out = run.out or default_path(sources[0].path.parent, name, "evaluation")
    output = Output.of(out, "evaluation", "evaluate", config, run, sources, code_digest(task))
    if kept := output.kept():
        return kept
    results: dict[str, list[np.ndarray]] = {}
    videos: list[np.ndarray] = []
    observation = first_observation(task)
    with (
        RenderPool.of(task, 1) as pool,
        run.progress.bar("evaluate", len(sources), "policies") as bar,
    ):
        for index, source in enumerate(sources):
            check_fits(source, task, observation)
            policy, contexts = Policy.load(source), recorded_contexts(source, task)
            for key, value in _episodes(task, policy, contexts, config.episodes, run.seed, index).items():
                results.setdefault(key, []).append(value)
            if len(videos) < SHOWN:
                videos.append(policy_video(task, policy, contexts, pool))
            bar.update(index + 1)
    arrays = {key: np.stack(values) for key, values in results.items()}
    summary = figures(arrays["normalised_distance"], arrays["normalised_distance_stochastic"], task.success_threshold)
    about = {"task": task.name, "success_threshold": task.success_threshold}
    described = full_config(
        "evaluate", config, run, **about, runs=[_describe(source, run.progress) for source in sources]
    )
    write_bytes(sibling(out, ".png"), plot_learning_curves(sources, task.success_threshold))
    labels = [stem_of(source.path)[-16:] for source in sources[:SHOWN]]
    write_mp4(sibling(out, ".mp4"), tile_videos([videos], labels=labels), fps=10)
    low, high = summary["success_paper_interval"]
    run.progress.say(
        f"evaluation: normalized final distance {summary['normalised_distance_stochastic']:.3f} (stochastic policy; "
        f"deterministic {summary['normalised_distance']:.3f}); {summary['succeeded']} of {len(sources)} runs succeed "
        f"by the paper's criterion (95% interval {low:.2f} to {high:.2f}), and "
        f"{summary['success_deterministic']:.0%} of the deterministic episodes"
    )
    pictures = {"curves": str(sibling(out, ".png")), "video": str(sibling(out, ".mp4"))}
    return output.write(
        arrays
        | {name: _padded([source[name] for source in sources]) for name in CURVES}
        | {f"summary/{k}": np.asarray(v, np.float64) for k, v in summary.items() if not isinstance(v, str)},
        config=described,
        summary={**summary, **pictures},
        parents=sources,
        environment=environment(),
    )


def _padded(rows: list[np.ndarray]) -> np.ndarray:
    """Rows of different lengths as one array (R, I), padded with NaN."""
    padded = np.full((len(rows), max(map(len, rows))), np.nan)
    for row, values in zip(padded, rows, strict=True):
        row[: len(values)] = values
    return padded


def _describe(source: Artifact, progress: Progress) -> dict[str, Any]:
    """The record of one of the evaluated runs; prints why something is unknown."""
    config = source.config
    method, problem = describe_method(source)
    if problem:
        progress.say(f"{source.path}: recorded as {method['method']}: {problem}")
    return {
        "policy": source.path.name,
        **method,
        "seed": source.manifest.seed,
        "context_seed": config["context_seed"],
        "contexts": config["contexts"],
        "vary": config.get("vary", ""),
        "translation_metrics": config["translation_metrics"],
        "samples": int(source["curve/samples"][-1]),
        "learning_minutes": float(source["curve/seconds"].sum() / 60),
        "last_batch_distance": float(source["curve/normalised_distance"][-1]),
    }


def _episodes(
    task: Any, policy: Any, contexts: Contexts, episodes: int, seed: int, index: int
) -> dict[str, np.ndarray]:
    """Distances (E,) of `episodes` deterministic episodes, and of stochastic ones from the same initial states."""
    import torch

    from stages.simulation.batch import rollout

    same = repeat(contexts, episodes)
    qpos, qvel = task.draw_states(generator(seed, "evaluate", index), same)
    noise = torch.Generator().manual_seed(integer(seed, "evaluate-noise", index))
    calm = rollout(task, same, qpos, qvel, lambda state, _: policy.act(task.observe(state)), 1)
    noisy = rollout(task, same, qpos, qvel, lambda state, _: policy.act(task.observe(state), noise), 1)
    return {
        "initial_distance": calm.initial_distance,
        "final_distance": calm.final_distance,
        "normalised_distance": calm.normalised_distance,
        "final_distance_stochastic": noisy.final_distance,
        "normalised_distance_stochastic": noisy.normalised_distance,
    }
