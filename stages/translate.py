"""translate: translate demonstrations into the learner's context, as if the expert acted there (Sec. V.A)."""

from __future__ import annotations

from contextlib import closing
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
    write_mp4,
)
from artifacts.atomic import write_bytes
from stages.config.environments import permission_needed
from stages.config.presets import defaults
from stages.config.stages import TranslateConfig
from stages.runtime.devices import pick_device, pick_workers
from stages.runtime.outputs import Output, name_tags
from stages.runtime.run import RunOptions, StageResult, check, environment, full_config
from stages.runtime.seeding import generator
from stages.simulation.contexts import Contexts

if TYPE_CHECKING:
    from stages.environments.spec import EnvironmentSpec
    from stages.learners.demonstrators import Demonstrator
    from stages.rewards.quality import Quality
    from stages.simulation.task import Task

CHUNK = 16  # demonstrations translated at a time


def translate(config: TranslateConfig, run: RunOptions, translator: Path) -> StageResult:
    """Translate demonstrations into the learner's context; write the `translation` artifact and an MP4 grid.

    Raises:
        ArtifactError: The translator's demonstrations are missing, or are not those that it was trained on.
        UsageError: The context image has the wrong size or cannot be read, or the demonstrations name no task.
    """
    import torch

    from stages.environments.demonstrators import demonstrator_digest, load_demonstrator
    from stages.environments.making import code_digest
    from stages.environments.scene import as_filmed, first_scene, image_scene
    from stages.reporting.grids import SHOWN, translation_grid
    from stages.reporting.plots import plot_quality
    from stages.rewards.quality import shown_tau
    from stages.rewards.tracking import motion
    from stages.rewards.trial import try_environment
    from stages.runtime.devices import use_threads
    from stages.simulation.gl import choose_backend
    from stages.simulation.registry import file_name, known_defaults
    from stages.translation.alignment import at_index, common_index, require_tslearn
    from stages.translation.networks import load_translator, to_frames, to_images

    check("translate", config, run)
    source = read_artifact(translator, "translator")
    demos = source.parent("demos", check=True)
    device = pick_device(run.device)
    use_threads(pick_workers(run.workers))
    align = config.align or source.config.get("align", "none")
    if align == "dtw":
        require_tslearn()
    _check_demonstrations(source, demos)
    config = as_filmed(config, demos, run.given or ())
    model, size = load_translator(source, device), source.config["size"]
    if config.env:
        where = f"{file_name(config.env)}-e{config.env_seed}"
    else:
        where = Path(config.context_image).stem if config.context_image else f"c{config.context_seed}"
    task_name = str(source.config.get("task") or "")
    usual = defaults(run.preset, "translate", task_name, own=known_defaults(task_name))
    tags = name_tags(config, usual, run, source.manifest.seed, source.config.get("preset", run.preset))
    out = run.out or default_path(source.path.parent, f"{stem_of(source.path)}-{where}{tags}", "translation")
    recipe = _image_digest(config) | code_digest(config.env, config.success)
    recipe |= demonstrator_digest(config.demonstrator) if config.demonstrator else {}
    output = Output.of(out, "translation", "translate", config, run, [source], recipe)
    if kept := output.kept():
        return kept
    contexts, expert, spec = None, None, None
    if config.env:
        spec, frame = first_scene(config, demos.describe()["frames"][0][1], (size[0], size[1]))
        seen = "" if spec.viewpoint is None else f", viewpoint {','.join(f'{value:g}' for value in spec.viewpoint)}"
        run.progress.say(f"context: {spec.name}, seed {spec.seed}, episodes of {spec.control_steps} steps{seen}")
        if config.demonstrator:
            load_demonstrator(config.demonstrator)  # What is wrong with it is told before the work.
        if note := permission_needed(spec.name, spec.kwargs, spec.success):
            run.progress.say(note)
    elif config.context_image:
        frame = image_scene(config, (size[0], size[1]))
    else:
        choose_backend()
        contexts, frame, expert = _simulate_context(config, demos, run)

    count, held_out = source.config["demonstrations"], source.config["held_out_demonstrations"]
    candidates = np.arange(0 if config.split == "all" else count - held_out, count)
    chosen = np.sort(generator(run.seed, "translate").permutation(candidates)[: config.n])
    if config.n > len(chosen):
        run.progress.say(f"translating {len(chosen)} demonstrations: --split {config.split} has no more")
    frames = np.stack([demos.read("frames", int(k)) for k in chosen])
    features, images, feature_motion, image_motion = [], [], [], []
    context_image = to_images(torch.from_numpy(frame[None].copy()).to(device))
    with torch.no_grad(), run.progress.bar("translate", len(frames), "demos") as bar:
        context = model.encode_context(context_image)
        for start in range(0, len(frames), CHUNK):
            videos = to_images(torch.from_numpy(frames[start : start + CHUNK]).to(device))
            z1 = model.encode(videos.flatten(0, 1))
            z3 = z1 if config.untranslated else model.translate(z1, context)
            feature_motion.append(motion(z1.unflatten(0, videos.shape[:2])).cpu())
            image_motion.append(motion(videos).cpu())
            decoded = videos if config.untranslated else model.decode(z3, context).unflatten(0, videos.shape[:2])
            features.append(z3.unflatten(0, videos.shape[:2]).cpu())
            images.append(decoded.cpu())
            bar.update(min(start + CHUNK, len(frames)))
    all_features, all_images = torch.cat(features), torch.cat(images)
    if align == "dtw":
        index = common_index(all_features.numpy())
        frames = np.take_along_axis(frames, np.rint(index).astype(int)[:, :, None, None, None], axis=1)
        all_features, all_images = at_index(all_features, index), at_index(all_images, index)
    target_features, target_images = all_features.mean(dim=0), all_images.mean(dim=0)
    arrays: dict[str, np.ndarray] = {
        "context_frame": frame,
        "target_features": target_features.numpy(),
        "target_images": target_images.movedim(1, -1).add(1).mul(127.5).numpy(),
        "features": all_features.numpy(),
        "images": to_frames(all_images).numpy(),
        "demonstrations": chosen,
        "feature_scale": torch.cat(feature_motion).mean().numpy(),
        "image_scale": torch.cat(image_motion).mean().numpy(),
    }
    metrics: dict[str, float] = {}
    if contexts is not None:
        arrays |= {f"contexts/{name}": values for name, values in contexts.items()}
    truth, quality, plot = None, None, sibling(out, ".png")
    if contexts is not None and expert is not None:
        truth, quality = _judge(contexts, expert, model, arrays, run, device)
    elif spec is not None and config.demonstrator:
        truth = _shown_once(spec, config.demonstrator, run)
    target = "untranslated target" if config.untranslated else "mean translation"
    if truth is not None:
        arrays |= _truth(model, truth, device, arrays, metrics)
        run.progress.say(
            f"{target} against the expert's video in this context: {metrics['psnr']:.2f} dB PSNR (copying the "
            f"context: {metrics['copy_psnr']:.2f}); pixel error {metrics['image_ratio']:.2f} relative to copying the "
            f"context, feature error {metrics['feature_ratio']:.2f} relative to feature motion (below 1 is better)"
        )
    if quality is not None:
        arrays |= {f"quality/{name}": values for name, values in quality.curves.items()}
        metrics |= quality.metrics
        run.progress.say(
            "Kendall's tau of reward and true progress: "
            + ", ".join(f"{shown_tau(metrics[f'tau_{kind}'])} ({kind})" for kind in ("expert", "noisy", "random"))
            + f"; of returns and final distances: {shown_tau(metrics['tau_returns'])}; along the path from standing "
            f"still to the expert: {shown_tau(metrics['tau_way'])}"
        )
        write_bytes(plot, plot_quality(quality.curves))
    else:
        plot.unlink(missing_ok=True)  # A leftover of an earlier translation.
    if spec is not None:
        trial = try_environment(spec, model, arrays, run.preset, run.seed, device)
        metrics |= trial.metrics
        for line in trial.lines():
            run.progress.say(line)
    described = full_config("translate", config, run, task=source.config.get("task"))
    described["align"] = align
    described["contexts"], described["vary"] = ("", "") if contexts is None else _contexts_of(config, demos)
    if spec is not None:
        described["environment"] = spec.described()
    grid = translation_grid(list(frames[:SHOWN]), arrays, len(frames), config.untranslated)
    write_mp4(sibling(out, ".mp4"), grid, fps=10)
    pictures = {"video": str(sibling(out, ".mp4")), **({"plot": str(plot)} if quality is not None else {})}
    return output.write(
        arrays | {f"metrics/{name}": np.asarray(value) for name, value in metrics.items()},
        config=described,
        summary={**metrics, "demonstrations": len(frames), **pictures},
        parents=[source],
        environment=environment(device),
    )


def _check_demonstrations(source: Artifact, demos: Artifact) -> None:
    """Raise ArtifactError if a translator's configuration contradicts the demonstrations that it was trained on."""
    count, _, *size, _ = demos.describe()["frames"][0]
    held_out = source.config["held_out_demonstrations"]
    if source.config["demonstrations"] != count or source.config["size"] != size or not 0 < held_out < count:
        raise ArtifactError(
            f"{source.path}: its configuration does not fit {demos.path}, which has {count} demonstrations of "
            f"{size[1]}x{size[0]} pixels: train it again"
        )


def _image_digest(config: TranslateConfig) -> dict[str, str]:
    """The SHA-256 of the context image, as part of the recipe; empty without a context image.

    Raises:
        UsageError: The file cannot be read.
    """
    if not config.context_image:
        return {}
    try:
        return {"context_image_sha256": sha256_of(config.context_image)}
    except ArtifactError as error:
        raise UsageError(f"--context-image {error}") from error


def _simulate_context(
    config: TranslateConfig, demos: Artifact, run: RunOptions
) -> tuple[Contexts, np.ndarray, Demonstrator | None]:
    """The learner's context (leading axis 1), its first frame, and the demonstrator, or None if it is unavailable."""
    from stages.learners.demonstrators import IMPORTED, demonstrator_of
    from stages.simulation.registry import distribution, learner_context, make_task
    from stages.simulation.render import RenderPool

    if not demos.config.get("task"):
        raise UsageError(
            f"{demos.path} names no simulated task: name a Gymnasium environment with --env ID, pass an image of the "
            "learner's context with --context-image PNG, or name the simulated task with import-demos --task"
        )
    task = make_task(demos.config["task"])
    _check_shape(task, demos)
    contexts = learner_context(task, config.context_seed, distribution(*_contexts_of(config, demos)))
    with RenderPool.of(task, 1) as pool:
        frame = pool.render(task.model_fields(contexts), task.context_state(contexts)[0][None])[0, 0]
    if demos.config.get("stage") == IMPORTED and task.demonstrator is None:
        return contexts, frame, None  # The expert's behavior in this context is unknown.
    try:
        return contexts, frame, demonstrator_of(task, demos)
    except ArtifactError as error:
        run.progress.say(f"no comparison with an expert video, because the expert is unavailable ({error})")
        return contexts, frame, None


def _check_shape(task: Task, demos: Artifact) -> None:
    """Raise UsageError if a simulated learner's videos differ in length or size from the demonstrations."""
    length, *size = demos.describe()["frames"][0][1:4]
    if (length, *size) != (task.frames, *task.frame_size):
        height, width = task.frame_size
        raise UsageError(
            f"{demos.path} has videos of {length} frames of {size[1]}x{size[0]} pixels, but "
            f"{task.frames} of {width}x{height} are needed for {task.name}: "
            f"use import-demos --frames {task.frames} --size {width}x{height}"
        )


def _judge(
    contexts: Contexts,
    expert: Demonstrator,
    model: Any,
    arrays: dict[str, np.ndarray],
    run: RunOptions,
    device: str,
) -> tuple[np.ndarray, Quality]:
    """The expert's own video (T, H, W, 3) in the learner's context, and how well the reward ranks behavior there."""
    from stages.rewards.quality import reward_quality
    from stages.rewards.tracking import TrackingTarget
    from stages.simulation.render import RenderPool

    task = expert.task
    # The reward with the settings that learn-policy will use.
    learning = defaults(run.preset, "learn-policy", task.name, own=task.defaults)
    with RenderPool.of(task, 1) as pool:
        quality = reward_quality(
            task,
            contexts,
            expert.begin,
            model,
            TrackingTarget.of(arrays, learning.blur, device),
            pool,
            generator(run.seed, "reward-quality"),
            learning.image_weight,
            device,
            expert.noise,
        )
        return expert.video(contexts, pool)[0], quality


def _shown_once(spec: EnvironmentSpec, demonstrator: str, run: RunOptions) -> np.ndarray:
    """The demonstrator's video (T, H, W, 3) in the learner's own context; prints whether it failed there."""
    from stages.environments.filming import Context, Studio
    from stages.environments.viewpoints import Viewpoint

    with closing(Studio(spec, demonstrator)) as studio:
        filmed = studio.film(Context(spec.seed, spec.viewpoint or Viewpoint()))
    if filmed.success is False:
        run.progress.say(f"the demonstrator {demonstrator} fails in this context: its video is not a valid reference")
    return filmed.frames


def _truth(
    model: Any, truth: np.ndarray, device: str, arrays: dict[str, np.ndarray], metrics: dict[str, float]
) -> dict[str, np.ndarray]:
    """The expert's own video and features in this context, as a perfect translation; adds to `metrics`."""
    import torch

    from stages.translation.metrics import feature_ratio, psnr, squared_error
    from stages.translation.networks import to_images

    video = to_images(torch.from_numpy(truth.copy())).to(device)
    with torch.no_grad():
        features = model.encode(video).cpu()
    video = video.cpu()
    target = torch.from_numpy(arrays["target_images"]).movedim(-1, 1) / 127.5 - 1
    copied = video[:1].expand_as(video)
    metrics |= {
        "psnr": float(psnr(target, video)[1:].mean()),
        "copy_psnr": float(psnr(copied, video)[1:].mean()),
        "image_ratio": float(squared_error(target, video).sum() / squared_error(copied, video).sum()),
        "feature_ratio": float(feature_ratio(torch.from_numpy(arrays["target_features"]), features)),
    }
    return {"expert_frames": truth, "expert_features": features.numpy()}


def _contexts_of(config: TranslateConfig, demos: Artifact) -> tuple[str, str]:
    """The learner's context distribution and varied factors; by default those of the demonstrations."""
    from stages.learners.demonstrators import filmed_contexts

    if config.contexts:
        return config.contexts, config.vary
    contexts, vary = filmed_contexts(demos)
    return contexts, config.vary or vary
