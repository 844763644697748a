"""train-translator: train a network that translates demonstrations between contexts (Sec. IV)."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from artifacts import ArtifactError, UsageError, default_path, read_artifact, stem_of
from stages.config.presets import changed, defaults
from stages.config.stages import TranslatorConfig
from stages.config.translation import FEW, STEPS_FOR_FEW
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.devices import pick_device, pick_workers
from stages.runtime.outputs import Output, name_tags
from stages.runtime.run import RunOptions, StageResult, check, environment, full_config

if TYPE_CHECKING:
    from stages.translation.networks import Translator

SHOWN_HELD_OUT = 32  # held-out demonstrations in evaluations during training; the final evaluation uses all
METRICS = (
    "psnr",
    "copy_psnr",
    "ssim",
    "copy_ssim",
    "trans",
    "copy_trans",
    "rec",
    "align",
    "copy_align",
    "feature_ratio",
)


def train_translator(config: TranslatorConfig, run: RunOptions, demos: Path, base: Path | None = None) -> StageResult:
    """Train on all but the held-out demonstrations and write the `translator` artifact.

    The contexts, which a demos artifact stores for audits, are never read.

    Args:
        config: Training configuration.
        run: Options of the run.
        demos: The demonstrations.
        base: A translator whose weights are fine-tuned (None: newly initialized weights). Its frames may have another
            size.

    Raises:
        ArtifactError: There are too few demonstrations, or `base` is not a translator.
        UsageError: `config.arch` is not the architecture of `base`.
    """
    import torch

    from stages.runtime.devices import use_threads
    from stages.simulation.registry import known_defaults
    from stages.translation.alignment import require_tslearn, video_index
    from stages.translation.bases import architecture, base_weights, described_base
    from stages.translation.evaluation import draw_translations, evaluate_translator
    from stages.translation.loop import FEWEST, held_out_count, train
    from stages.translation.training import TranslatorTraining, parallel_groups

    check("train-translator", config, run)
    if config.align == "dtw":
        require_tslearn()
    source = read_artifact(demos, "demos")
    started = None if base is None else read_artifact(base, "translator")
    parents = [source] if started is None else [source, started]
    if started is not None and config.arch != architecture(started):
        raise UsageError(f"--arch {config.arch}: {base} has architecture {architecture(started)}")
    device = run.processes.device or pick_device(run.device)
    workers = pick_workers(run.workers)
    workers = workers if run.workers else max(workers // run.processes.here, 1)
    threads = min(workers, parallel_groups(config, device, len(run.processes.share(config.groups))))
    use_threads(max(workers // threads, 1))
    task = str(source.config.get("task") or "")
    usual = defaults(run.preset, "train-translator", task, own=known_defaults(task))
    tags = name_tags(config, usual, run, source.manifest.seed, source.config.get("preset", run.preset))
    tags += "" if started is None else f"-from-{stem_of(started.path)}"
    out = run.out or default_path(source.path.parent, stem_of(source.path) + tags, "translator")
    output = Output.of(out, "translator", "train-translator", config, run, parents)
    if kept := output.kept():
        run.processes.finish()
        return kept
    frames = torch.from_numpy(source["frames"])
    held_out = held_out_count(len(frames), config.held_out)
    if len(frames) < FEWEST:
        more = "import more videos" if source.config.get("stage") == "import-demos" else "collect more with -n"
        raise ArtifactError(f"{demos} contains {len(frames)} demonstrations, expected at least {FEWEST}: {more}")
    config = _suited(config, run, len(frames))
    weights = None if started is None else base_weights(started, (frames.shape[2], frames.shape[3]))
    training = TranslatorTraining(config, frames[:-held_out], run.seed, device, run.processes, weights, threads)
    described = full_config("train-translator", config, run, task=source.config.get("task"))
    described |= {"demonstrations": len(frames), "held_out_demonstrations": held_out, "size": list(frames.shape[2:4])}
    if started is not None:
        described["base"] = described_base(started)

    def evaluate(model: Translator, limit: int = SHOWN_HELD_OUT) -> dict[str, float]:
        """Held-out metrics. If videos are aligned, they are computed on time-aligned videos."""
        videos = frames[-held_out:][:limit]
        if config.align == "dtw":
            index = torch.from_numpy(video_index(model, videos, frames[0, 0], device))
            videos = videos[torch.arange(len(videos))[:, None], index]
        return evaluate_translator(model, videos, device)

    checkpoints = Checkpoints(run, out, "train-translator", described, parents)
    held_out_frames = frames[-held_out:]
    curve = train(
        training,
        evaluate,
        run,
        out,
        checkpoints,
        lambda model: draw_translations(model, held_out_frames, device),
    )
    if not run.processes.main:
        run.processes.finish()
        return StageResult(out, {})
    described["kept_step"] = training.best.step or training.step
    measured = evaluate(training.average, held_out)
    metrics = {name: measured[name] for name in METRICS}
    run.progress.say(
        f"held out: {metrics['psnr']:.2f} dB PSNR (copying the context: {metrics['copy_psnr']:.2f}), "
        f"SSIM {metrics['ssim']:.3f} ({metrics['copy_ssim']:.3f}), feature ratio {metrics['feature_ratio']:.2f}"
    )
    if advice := _advice(metrics, config, len(frames), fine_tuned=started is not None):
        run.progress.say(advice)
    result = output.write(
        {
            **{f"weights/{k}": v.detach().cpu().numpy() for k, v in training.average.state_dict().items()},
            **{f"curve/{name}": np.asarray(values) for name, values in curve.items()},
            **{f"metrics/{name}": np.asarray(value) for name, value in metrics.items()},
        },
        config=described,
        summary=metrics,
        parents=parents,
        environment=environment(device) | ({"processes": str(run.processes.count)} if run.processes.count > 1 else {}),
    )
    checkpoints.remove()
    run.processes.finish()
    return result


def _suited(config: TranslatorConfig, run: RunOptions, demonstrations: int) -> TranslatorConfig:
    """Return the configuration with what suits few demonstrations, where the user decided nothing else.

    Training videos are augmented, and the compact network trains for fewer steps.
    """
    if demonstrations >= FEW or not config.steps:
        return config
    given = changed("train-translator", config) if run.given is None else run.given
    own: dict[str, Any] = {} if config.augment or "augment" in given else {"augment": True}
    if config.arch == "compact" and config.steps > STEPS_FOR_FEW and "steps" not in given:
        own["steps"] = STEPS_FOR_FEW
    if own:
        told = {
            "augment": "training videos are augmented (--no-augment: not)",
            "steps": f"{STEPS_FOR_FEW} steps (--steps)",
        }
        run.progress.say(f"{demonstrations} demonstrations are few: {', '.join(told[name] for name in own)}")
    return dataclasses.replace(config, **own)


def _advice(metrics: dict[str, float], config: TranslatorConfig, demonstrations: int, *, fine_tuned: bool) -> str:
    """Return one line about features that lead nowhere, with what may help; empty if tracking them leads to the goal.

    Args:
        metrics: Final held-out metrics.
        config: Training configuration.
        demonstrations: Number of demonstrations.
        fine_tuned: Whether training started from another translator.
    """
    if metrics["feature_ratio"] < 1.0:
        return ""
    ways = [f"more than {config.steps} steps (--steps)", f"more than {demonstrations} demonstrations"]
    if not config.augment:
        ways.append("--augment")
    if not fine_tuned:
        ways.append("--from with a translator that learned from more videos")
    ways.append("demonstrations from a narrower range of viewpoints")
    return (
        f"a policy will probably not learn from this translator: its feature ratio is "
        f"{metrics['feature_ratio']:.2f}, and at 1 or more, tracking the features is no better than standing still. "
        f"What may help: {', '.join(ways[:-1])}, or {ways[-1]}"
    )
