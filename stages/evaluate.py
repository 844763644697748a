"""evaluate: measure how often, and how closely, policies reach a goal that they never observe."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from stages.reporting.judging import Foreign, Judge, Simulated
from stages.reporting.methods import describe_method
from stages.runtime.devices import pick_workers
from stages.runtime.outputs import Output
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions, StageResult, check, environment, full_config

if TYPE_CHECKING:
    from stages.environments.spec import EnvironmentSpec

SHOWN = 6  # policies shown in the MP4
# Learning curves copied from the policies.
CURVES = ("curve/samples", "curve/normalised_distance", "curve/success", "curve/env_return")


def evaluate(config: EvaluateConfig, run: RunOptions, policies: list[Path]) -> StageResult:
    """Evaluate policies of one task or environment; write the `evaluation` artifact, learning curves and a video.

    In a simulated task, a run succeeds by the paper's criterion if the stochastic policy's normalized final distance,
    averaged over episodes, is below the task's threshold. In a Gymnasium environment, episodes succeed if the
    environment reports it. The success rate of the deterministic policy's episodes is reported too.
    """
    from stages.environments.foreign import processes_for
    from stages.environments.spec import EnvironmentSpec
    from stages.reporting.plots import plot_learning_curves
    from stages.runtime.devices import use_threads
    from stages.simulation.gl import choose_backend

    check("evaluate", config, run)
    choose_backend()
    places = [real(path) for path in policies]
    twice = [path for path, place in zip(policies, places, strict=True) if places.count(place) > 1]
    if twice:
        raise UsageError(f"{twice[0]}: given twice: pass each policy once; duplicates narrow the intervals")
    sources = [read_artifact(path, "policy") for path in policies]
    specs = [EnvironmentSpec.of(source) for source in sources]
    names = sorted({_place_of(source, spec) for source, spec in zip(sources, specs, strict=True)})
    if len(names) > 1:
        raise ArtifactError(f"policies of different tasks ({', '.join(names)}): evaluate each task separately")
    workers = use_threads(pick_workers(run.workers))
    name = stem_of(sources[0].path) + (f"-and-{len(sources) - 1}-more" if len(sources) > 1 else "")
    name += "" if run.seed == sources[0].manifest.seed else f"-s{run.seed}"
    out = run.out or default_path(sources[0].path.parent, name, "evaluation")
    judge: Judge = Simulated(names[0]) if specs[0] is None else Foreign(specs, processes_for(config.episodes, workers))
    output = Output.of(out, "evaluation", "evaluate", config, run, sources, judge.recipe)
    if kept := output.kept():
        return kept
    results: dict[str, list[np.ndarray]] = {}
    videos: list[np.ndarray] = []
    with run.progress.bar("evaluate", len(sources), "policies") as bar:
        for index, source in enumerate(sources):
            for key, value in judge.episodes(source, config.episodes, run.seed, index).items():
                results.setdefault(key, []).append(value)
            if len(videos) < SHOWN:
                videos.append(judge.video(source, index))
            bar.update(index + 1)
    arrays = {key: np.stack(values) for key, values in results.items() if len(values) == len(sources)}
    summary = judge.figures(arrays)
    described = full_config(
        "evaluate", config, run, **judge.about, runs=[_describe(source, run.progress) for source in sources]
    )
    curve, label, threshold = judge.curve(sources)
    write_bytes(sibling(out, ".png"), plot_learning_curves(sources, threshold, curve, label))
    labels = [stem_of(source.path)[-16:] for source in sources[:SHOWN]]
    write_mp4(sibling(out, ".mp4"), tile_videos([videos], labels=labels, scale=1), fps=10)
    run.progress.say(f"evaluation: {judge.verdict(summary, len(sources))}")
    pictures = {"curves": str(sibling(out, ".png")), "video": str(sibling(out, ".mp4"))}
    curves = [name for name in CURVES if all(name in source for source in sources)]
    return output.write(
        arrays
        | {name: _padded([source[name] for source in sources]) for name in curves}
        | {f"summary/{k}": np.asarray(v, np.float64) for k, v in summary.items() if not isinstance(v, str)},
        config=described,
        summary={**summary, **pictures},
        parents=sources,
        environment=environment(),
    )


def _place_of(source: Artifact, spec: EnvironmentSpec | None) -> str:
    """What must be equal for policies to be evaluated together: the task, or the environment without its context.

    Raises:
        ArtifactError: The policy has neither.
    """
    if spec is not None:
        return " ".join([spec.name, *(f"{key}={value}" for key, value in spec.kwargs.items()), str(spec.control_steps)])
    if not source.config.get("task"):
        raise ArtifactError(f"{source.path}: its configuration lacks a task and an environment: learn it again")
    return str(source.config["task"])


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
        **({"environment": config["environment"]} if config.get("environment") else {}),
        "context_seed": config.get("context_seed", -1),
        "contexts": config.get("contexts", ""),
        "vary": config.get("vary", ""),
        "translation_metrics": config["translation_metrics"],
        "samples": int(source["curve/samples"][-1]),
        "learning_minutes": float(source["curve/seconds"].sum() / 60),
        "last_batch_distance": _last(source, "curve/normalised_distance"),
    }


def _last(source: Artifact, curve: str) -> float | None:
    return float(source[curve][-1]) if curve in source else None
