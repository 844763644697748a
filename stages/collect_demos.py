"""collect-demos: record a demonstrator in random contexts. The videos are the only input of the later stages."""

from __future__ import annotations

import dataclasses
import itertools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from artifacts import (
    ArtifactError,
    UsageError,
    atomic_folder,
    checkpoint_path,
    default_path,
    read_artifact,
    write_mp4,
    write_overview,
)
from artifacts.paths import is_missing, real
from stages.config.environments import PREFIX
from stages.config.fields import flag
from stages.config.presets import DEFAULT_PRESET, defaults
from stages.config.stages import DemosConfig
from stages.environments.attempts import FEWEST_ATTEMPTS, MAX_ATTEMPTS
from stages.learners.demonstrators import Demonstrator, Expert, Person
from stages.runtime.devices import pick_workers
from stages.runtime.outputs import Output, name_tags
from stages.runtime.run import RunOptions, StageResult, check, environment, full_config
from stages.runtime.seeding import generator
from stages.simulation.contexts import Contexts, repeat, take
from stages.simulation.task import Task

# Options that have no effect on environments, and on simulated tasks.
OF_TASKS = ("contexts", "vary", "context_seed", "jitter", "videos", "crf", "expert")
OF_ENVIRONMENTS = (
    "demonstrator",
    "env_kwargs",
    "episode_steps",
    "frames",
    "size",
    "crop",
    "viewpoint",
    "success",
    "azimuth",
    "elevation",
    "distance",
)
Film = Callable[[dict[str, np.ndarray], np.ndarray], None]

CHUNK = 256  # demonstrations simulated and rendered at a time
FOOTAGE_SCALE = 5  # MP4 pixels per frame pixel, along each side
TEMPO_KNOTS = 3  # speeds that define a video's time warping


def collect_demos(task_name: str, config: DemosConfig, run: RunOptions, expert: Path | None) -> StageResult:
    """Collect `config.n` demonstrations and write the `demos` artifact, a contact sheet and an MP4.

    A task without a scripted demonstrator is demonstrated by an expert. Without `expert`, the task's expert is loaded
    from the output folder, or trained and saved there first.

    Raises:
        ArtifactError: The demonstrator fails too often to yield `config.n` demonstrations.
        UsageError: An expert is given although the task has a scripted demonstrator.
    """
    from stages.runtime.devices import use_threads
    from stages.simulation.gl import choose_backend
    from stages.simulation.registry import code_digest, distribution, file_name, make_task

    check("collect-demos", config, run)
    choose_backend()
    _check_given(task_name, run)
    if task_name.startswith(PREFIX):
        return _collect_in_environment(task_name.removeprefix(PREFIX), config, run)
    task = make_task(task_name, typed=True)
    workers = use_threads(pick_workers(run.workers))
    usual = defaults(run.preset, "collect-demos", task_name, own=task.defaults)
    name = file_name(task_name) + name_tags(config, usual, run, 0, DEFAULT_PRESET)
    out = run.out or default_path(Path("runs"), name, "demos")
    drawn_from = distribution(config.contexts, config.vary)
    task.varied(drawn_from)  # Reports a bad distribution before an expert is trained.
    known = expert or (None if task.demonstrator else _find_expert(task_name, run, out.parent))
    output = Output.of(
        out, "demos", "collect-demos", config, run, [known] if known else [], {"task": task.name, **code_digest(task)}
    )
    if output.found and not run.overwrite and config.videos and not os.path.isdir(config.videos):
        raise UsageError(f"{out} exists, but its footage {config.videos} does not: use --overwrite to redo both")
    if kept := output.kept():
        return kept
    _check_footage(config, out)
    demonstrator = _demonstrator(task, expert, run, out.parent)
    output = output.made_from(demonstrator.parents)
    with _footage(demonstrator.task, config) as write:  # The footage folder appears only once the artifact is written.
        return _film(task, demonstrator, config, output, workers, write)


def _check_given(task_name: str, run: RunOptions) -> None:
    """Refuse options that have no effect: some are of simulated tasks, some of Gymnasium environments."""
    foreign = task_name.startswith(PREFIX)
    for name in sorted((run.given or frozenset()) & set(OF_TASKS if foreign else OF_ENVIRONMENTS)):
        others = "simulated tasks" if foreign else "env:ID"
        raise UsageError(f"{flag(name)} has no effect on {task_name}, only on {others}: leave it out")


def _collect_in_environment(name: str, config: DemosConfig, run: RunOptions) -> StageResult:
    """Film a demonstrator in a Gymnasium environment, each video with its own seed and viewpoint.

    Raises:
        ArtifactError: The demonstrator fails too often.
        UsageError: The environment or the demonstrator fails, or an option is missing.
    """
    from stages.environments.demonstrators import demonstrator_digest
    from stages.environments.filming import draw_contexts, film_successes
    from stages.environments.making import code_digest
    from stages.environments.scene import filmed_scene
    from stages.environments.viewpoints import Viewpoint
    from stages.simulation.registry import file_name

    if not config.demonstrator:
        raise UsageError(f"env:{name}: give --demonstrator MODULE:ATTR, or a model of Stable-Baselines3 (.zip)")
    spec, can_move = filmed_scene(name, config, run.seed % 2**32)
    usual = defaults(run.preset, "collect-demos")
    out = run.out or default_path(
        Path("runs"), file_name(name) + name_tags(config, usual, run, 0, DEFAULT_PRESET), "demos"
    )
    recipe = {"environment": name, **code_digest(spec.name, spec.success), **demonstrator_digest(config.demonstrator)}
    output = Output.of(out, "demos", "collect-demos", config, run, [], recipe)
    if kept := output.kept():
        return kept
    if not can_move:
        run.progress.say(f"{name} has no camera of MuJoCo: all videos have its own viewpoint")

    ranges = Viewpoint(config.azimuth, config.elevation, config.distance) if can_move else None
    with run.progress.bar(f"collect-demos {name}", config.n, "demos") as bar:
        contexts = draw_contexts(run.seed, spec.viewpoint or Viewpoint(), ranges)
        chosen, dropped = film_successes(spec, config.demonstrator, contexts, config, pick_workers(run.workers), bar)
    known = [filmed.success for _, filmed in chosen if filmed.success is not None]
    if not known:
        run.progress.say(f"{name} does not report success: all demonstrations are kept")
    elif not config.keep_failures:
        run.progress.say(f"dropped {dropped} of {dropped + config.n} demonstrations because they failed")
    videos = np.stack([filmed.frames for _, filmed in chosen])
    returns = np.array([filmed.env_return for _, filmed in chosen])
    described = full_config("collect-demos", config, run, task=None, dropped=dropped, environment=spec.described())
    pictures = write_overview(output.path, videos)
    return output.write(
        {
            "frames": videos,
            "env_return": returns,
            **({"success": np.array(known, np.float64)} if len(known) == len(chosen) else {}),
            "environment/seed": np.array([context.seed for context, _ in chosen]),
            "environment/viewpoint": np.array([context.viewpoint for context, _ in chosen]),
        },
        config=described,
        summary={"demos": len(chosen), "dropped": dropped, "env_return": float(returns.mean()), **pictures},
        environment=environment(),
    )


def _film(
    task: Task, demonstrator: Demonstrator, config: DemosConfig, output: Output, workers: int, write: Film
) -> StageResult:
    """Record `config.n` demonstrations and write the artifact. `write` receives all footage."""
    from stages.simulation.batch import rollout
    from stages.simulation.registry import distribution, learner_context
    from stages.simulation.render import RenderPool

    run = output.run
    filmed, drawn_from = demonstrator.task, distribution(config.contexts, config.vary)
    videos = np.empty((config.n, task.frames, *task.frame_size, 3), np.uint8)
    contexts: list[Contexts] = []
    initial: list[np.ndarray] = []
    final: list[np.ndarray] = []
    played: list[np.ndarray] = []
    kept = dropped = chunks = 0
    chunk = min(CHUNK, config.n)
    with (
        RenderPool.of(filmed, workers) as pool,
        run.progress.bar(f"collect-demos {task.name}", config.n, "demos") as bar,
    ):
        while kept < config.n:
            attempts = kept + dropped
            if attempts >= FEWEST_ATTEMPTS and (attempts >= MAX_ATTEMPTS * config.n or not kept):
                who = demonstrator.parents[0].path if demonstrator.parents else f"task {task.name}"
                longer = f"train it longer (ifo train-expert {task.name} --iterations N), or "
                raise ArtifactError(
                    f"{who}: the demonstrator failed in {dropped} of {attempts} contexts; at least a quarter "
                    f"must end below {task.expert_threshold} of the initial distance: "
                    f"{longer if demonstrator.parents else ''}keep failures (--keep-failures)"
                )
            rng = generator(run.seed, "demos", chunks)
            if config.context_seed < 0:
                drawn = task.draw_contexts(rng, chunk, drawn_from)
                starts = filmed.context_state(drawn)
            else:
                drawn = repeat(learner_context(task, config.context_seed, drawn_from), chunk)
                starts = filmed.draw_states(rng, drawn)  # One context for all: a single start would repeat one video.
            act = demonstrator.begin(drawn, generator(run.seed, "demonstrator", chunks))
            episode = rollout(filmed, drawn, *starts, act, workers)
            good = config.keep_failures | (episode.normalised_distance < task.expert_threshold)
            chosen = np.flatnonzero(good)[: config.n - kept]
            kept, chunks = kept + len(chosen), chunks + 1
            looked_at = int(chosen[-1]) + 1 if kept == config.n else len(good)
            dropped += looked_at - len(chosen)
            if not len(chosen):
                continue
            part = take(drawn, chosen)
            times = playback(generator(run.seed, "tempo", chunks - 1), chunk, task.frames, config.jitter)[chosen]
            steps = np.rint(times * task.frame_every).astype(int)
            qpos = np.take_along_axis(episode.qpos[chosen], steps[:, :, None], axis=1)
            videos[kept - len(chosen) : kept] = pool.render(filmed.model_fields(part), qpos)
            write(filmed.model_fields(part), qpos)
            played.append(times)
            contexts.append(part)
            initial.append(episode.initial_distance[chosen])
            final.append(episode.final_distance[chosen])
            bar.update(kept, dropped=dropped)

    initial_distance, final_distance = np.concatenate(initial), np.concatenate(final)
    if not config.keep_failures:
        run.progress.say(f"dropped {dropped} of {kept + dropped} demonstrations because they failed")
    arrays = {
        "frames": videos,
        "initial_distance": initial_distance,
        "final_distance": final_distance,
        **({"playback": np.concatenate(played)} if config.jitter else {}),
        **{f"contexts/{name}": np.concatenate([part[name] for part in contexts]) for name in contexts[0]},
    }
    described = full_config("collect-demos", config, run, task=task.name, dropped=dropped)
    pictures = write_overview(output.path, videos)
    summary = {
        "demos": kept,
        "dropped": dropped,
        "frames": int(videos.shape[0] * videos.shape[1]),
        "normalised_distance": float((final_distance / initial_distance).mean()),
        **pictures,
        **({"footage": config.videos} if config.videos else {}),
    }
    return output.write(
        arrays, config=described, summary=summary, parents=demonstrator.parents, environment=environment()
    )


def playback(rng: np.random.Generator, n: int, frames: int, jitter: float) -> np.ndarray:
    """Time warping of n videos: source times (n, T) in frames of the unwarped video, non-decreasing from 0.

    The playback speed is piecewise linear, with speeds drawn from [1 - jitter, 1 + jitter] at the start, the middle
    and the end. Fast videos repeat their last frame; slow ones stop before it. Without jitter: 0, 1, 2, ...
    """
    speeds = rng.uniform(1 - jitter, 1 + jitter, (n, TEMPO_KNOTS))
    at = np.linspace(0, TEMPO_KNOTS - 1, frames - 1)
    steps = np.stack([np.interp(at, np.arange(TEMPO_KNOTS), knots) for knots in speeds])
    return np.minimum(np.concatenate([np.zeros((n, 1)), steps.cumsum(axis=1)], axis=1), frames - 1)


def _check_footage(config: DemosConfig, out: Path) -> None:
    """Refuse a footage folder that exists, or that would contain the artifact."""
    folder = Path(config.videos)
    if config.videos and os.path.lexists(folder):
        raise UsageError(f"--videos {folder}: already exists: remove it or choose another name")
    if config.videos and real(folder) in real(out).parents:
        raise UsageError(f"--videos {folder}: {out} would be written into it: choose a separate folder for the footage")


@contextmanager
def _footage(task: Task, config: DemosConfig) -> Iterator[Film]:
    """Yield a function (fields, qpos) that writes videos to the folder `config.videos`, or a no-op if that is empty."""
    from stages.simulation.render import RenderPool

    if not config.videos:
        yield lambda fields, qpos: None
        return
    height, width = (FOOTAGE_SCALE * side for side in task.frame_size)
    fps = 1 / (task.control_timestep * task.frame_every)
    numbers = itertools.count()
    with atomic_folder(config.videos) as temporary, RenderPool(task.model, height, width, 1, task.camera) as pool:

        def write(fields: dict[str, np.ndarray], qpos: np.ndarray) -> None:
            for k in range(len(qpos)):
                one = {name: values[k : k + 1] for name, values in fields.items()}
                frames = pool.render(one, qpos[k : k + 1])[0]
                write_mp4(temporary / f"demo-{next(numbers):05d}.mp4", frames, fps, min_height=1, crf=config.crf)

        yield write


def _demonstrator(task: Task, expert: Path | None, run: RunOptions, folder: Path) -> Demonstrator:
    """The demonstrator to record."""
    if task.demonstrator is None:
        return Expert(task, expert or _found_or_trained_expert(task, run, folder))
    if expert:
        raise UsageError(f"--expert {expert}: {task.name} has a scripted demonstrator: omit the option")
    return Person(task)


def _expert_path(task_name: str, run: RunOptions, folder: Path) -> Path:
    """Default path of the expert for this task and preset."""
    from stages.simulation.registry import file_name

    return default_path(folder, f"{file_name(task_name)}-{run.preset}", "expert")


def _find_expert(task_name: str, run: RunOptions, folder: Path) -> Path | None:
    """Path of the expert for this task and preset in `folder`; None if it does not exist.

    Raises:
        ArtifactError: The file is not a readable expert.
    """
    path = _expert_path(task_name, run, folder)
    if is_missing(path):
        return None
    read_artifact(path, "expert")
    return path


def _found_or_trained_expert(task: Task, run: RunOptions, folder: Path) -> Path:
    """Path of the expert for this task and preset in `folder`. It is trained now if it does not exist."""
    from stages.train_expert import train_expert

    path = _find_expert(task.name, run, folder)
    if path is not None:
        run.progress.say(f"using expert {path}")
        return path
    path = _expert_path(task.name, run, folder)
    run.progress.say(f"no expert for {task.name} yet: training one and saving it as {path}")
    command = f"ifo train-expert {task.name} --preset {run.preset} --seed {run.seed} --out {path}"
    expert_run = dataclasses.replace(
        run, out=path, command=command, resume=not is_missing(checkpoint_path(path)), overwrite=False, given=frozenset()
    )
    config = defaults(run.preset, "train-expert", task.name, own=task.defaults)
    return train_expert(task.name, config, expert_run).path
