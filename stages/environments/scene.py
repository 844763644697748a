"""The learner's context outside the simulated tasks: the first frame of a Gymnasium environment, or an image."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import replace

import gymnasium
import numpy as np

from artifacts import Artifact, UsageError, read_png
from stages.config.demonstrations import Crop, parse_crop, parse_size
from stages.config.environments import parse_kwargs, parse_viewpoint, refuse_unless_trusted
from stages.config.fields import flag
from stages.config.stages import DemosConfig, TranslateConfig
from stages.config.translation import OF_ENVIRONMENTS
from stages.environments.making import EnvironmentFault, episode_limit, fault, frame_of, make_environment, rendered
from stages.environments.spec import EnvironmentSpec
from stages.environments.viewpoints import Viewpoint
from stages.footage.crops import reduced


def first_scene(config: TranslateConfig, frames: int, size: tuple[int, int]) -> tuple[EnvironmentSpec, np.ndarray]:
    """Return the environment that `config` names, and its first frame (H, W, 3), uint8.

    Args:
        config: Configuration of translate, with `env`.
        frames: Number of frames T of the demonstrations.
        size: Height and width of their frames.

    Raises:
        EnvironmentFault: The environment cannot be made, or its code fails.
        UsageError: Its episodes have no limit, or fewer steps than the demonstrations have frames.
    """
    crop = parse_crop(config.crop) if config.crop else None
    kwargs = parse_kwargs(config.env_kwargs)
    viewpoint = parse_viewpoint(config.viewpoint)
    looking = None if viewpoint is None else Viewpoint(*viewpoint)
    spec = EnvironmentSpec(
        config.env, kwargs, config.env_seed, config.episode_steps, frames, size, crop, looking, config.success
    )
    env = make_environment(spec)
    try:
        spec = _with_steps(spec, env)
        frame = first_frame(env, spec)
        _refuse_stretched(spec, env)
        return spec, frame
    finally:
        env.close()


def filmed_scene(name: str, config: DemosConfig, seed: int) -> tuple[EnvironmentSpec, bool]:
    """Return the environment in which collect-demos films, and whether its camera can be moved.

    Args:
        name: Name of the environment.
        config: Configuration of collect-demos.
        seed: Seed that the demonstrations record.

    Raises:
        EnvironmentFault, UsageError: As `first_scene`.
    """
    crop = parse_crop(config.crop) if config.crop else None
    kwargs, size = parse_kwargs(config.env_kwargs), parse_size(config.size)
    viewpoint = parse_viewpoint(config.viewpoint)
    looking = None if viewpoint is None else Viewpoint(*viewpoint)
    spec = EnvironmentSpec(name, kwargs, seed, config.episode_steps, config.frames, size, crop, looking, config.success)
    env = make_environment(spec, raw=True)
    try:
        spec = _with_steps(spec, env)
        first_frame(env, spec)
        _refuse_stretched(spec, env)
        return spec, bool(env.get_wrapper_attr("can_move"))
    finally:
        env.close()


def _with_steps(spec: EnvironmentSpec, env: gymnasium.Env) -> EnvironmentSpec:
    """The environment with the length of its episodes, if it was left open."""
    try:
        steps = spec.control_steps or episode_limit(env)
    except Exception as error:
        raise EnvironmentFault(fault(spec, env, "the limit of its episodes", error)) from error
    if not steps:
        raise UsageError(f"environment {spec.name}: sets no limit to its episodes: give --episode-steps")
    if steps < spec.frames - 1:
        raise UsageError(
            f"environment {spec.name}: episodes of {steps} steps are too short for videos of {spec.frames} frames: "
            f"give --episode-steps {spec.frames - 1} or more"
        )
    return replace(spec, control_steps=steps)


def _refuse_stretched(spec: EnvironmentSpec, env: gymnasium.Env) -> None:
    height, width = spec.size
    if spec.crop is None and _stretched(env.render(), spec.size):
        raise UsageError(
            f"environment {spec.name}: its images have another aspect ratio than frames of {width}x{height}: crop them "
            "with --crop X,Y,W,H"
        )


def as_filmed(config: TranslateConfig, demos: Artifact, given: Collection[str]) -> TranslateConfig:
    """The configuration with the environment in which demonstrations were filmed, if no other place was chosen.

    If `--env` names that environment, what decides how it is filmed and was left out is taken from the demonstrations:
    viewpoint, crop and steps per episode; but not arguments and functions, which are the user's.

    Raises:
        UsageError: Making that environment needs the user's permission, or an option in `given` has no effect there.
    """
    recorded = EnvironmentSpec.recorded(demos)
    if config.env and (recorded is None or recorded.name != config.env):
        return config
    if config.context_image or recorded is None:
        for name in (*OF_ENVIRONMENTS, *(() if config.context_image else ("crop",))):
            if name in given:
                raise UsageError(f"{flag(name)} has no effect without --env: give --env as well, or leave it out")
        return config
    for name in ("context_seed", "contexts", "vary"):
        if name in given:
            raise UsageError(
                f"{flag(name)} has no effect on demonstrations of environment {recorded.name}: "
                "use --env-seed and --viewpoint"
            )
    viewpoint, crop = recorded.viewpoint, recorded.crop
    filmed = replace(
        config,
        episode_steps=config.episode_steps or recorded.control_steps,
        viewpoint=config.viewpoint or ("" if viewpoint is None else ",".join(f"{value:g}" for value in viewpoint)),
        crop=config.crop or ("" if crop is None else ",".join(map(str, crop))),
    )
    if config.env:
        return filmed
    arguments = tuple(f"{key}={json.dumps(value)}" for key, value in recorded.kwargs.items())
    refuse_unless_trusted(recorded.name, {} if config.env_kwargs else recorded.kwargs)
    if recorded.success and not config.success:
        refuse_unless_trusted(recorded.success, {})
    return replace(
        filmed,
        env=recorded.name,
        env_kwargs=config.env_kwargs or arguments,
        success=config.success or recorded.success,
    )


def first_frame(env: gymnasium.Env, spec: EnvironmentSpec) -> np.ndarray:
    """The frame (H, W, 3), uint8, that an environment shows after `reset` with the context's seed.

    Raises:
        EnvironmentFault: Its code fails.
    """
    where = "reset"
    try:
        env.reset(seed=spec.seed)
        where = "render"
        return frame_of(rendered(env, spec), spec)
    except EnvironmentFault:
        raise
    except (Exception, SystemExit) as error:
        raise EnvironmentFault(fault(spec, env, where, error)) from error


def picture_spec(spec: EnvironmentSpec, factor: int) -> EnvironmentSpec:
    """The environment with frames `factor` times as large, or as many times as its images allow.

    Raises:
        EnvironmentFault: Its code fails.
    """
    height, width = spec.size
    env = make_environment(replace(spec, size=(factor * height, factor * width)))
    try:
        first_frame(env, spec)
        shown = rendered(env, spec).shape if spec.crop is None else (spec.crop.h, spec.crop.w)
    finally:
        env.close()
    most = max(1, min(factor, shown[0] // height, shown[1] // width))
    return replace(spec, size=(most * height, most * width))


def _stretched(image: object, size: tuple[int, int]) -> bool:
    from stages.rewards.scene_checks import stretch_problem

    return isinstance(image, np.ndarray) and bool(stretch_problem(image.shape, size))


def image_scene(config: TranslateConfig, size: tuple[int, int]) -> np.ndarray:
    """Read the context frame (H, W, 3), uint8, from a PNG: cropped, and reduced to `size` by area averaging.

    Raises:
        UsageError: The image is too small, or has another aspect ratio.
    """
    image, path, (height, width) = read_png(config.context_image), config.context_image, size
    crop = parse_crop(config.crop) if config.crop else Crop(0, 0, image.shape[1], image.shape[0])
    if crop.x + crop.w > image.shape[1] or crop.y + crop.h > image.shape[0]:
        raise UsageError(f"--crop {config.crop}: extends beyond {path} of {image.shape[1]}x{image.shape[0]} pixels")
    if crop.w < width or crop.h < height or _stretched(image[: crop.h, : crop.w], size):
        raise UsageError(
            f"--context-image {path}: {crop.w}x{crop.h} pixels, expected {width}x{height} or more in the same aspect "
            "ratio: crop it with --crop X,Y,W,H"
        )
    return reduced(image, crop, size)


def check_first_frame(spec: EnvironmentSpec, context_frame: np.ndarray, target: np.ndarray) -> list[str]:
    """Return why an environment does not show the context that a target was translated into, one line per problem.

    Args:
        spec: The environment.
        context_frame: The context frame (H, W, 3), uint8.
        target: The target's images (T, H, W, 3), 0 to 255.

    Raises:
        EnvironmentFault: The environment's code fails.
    """
    import torch

    from stages.rewards.scene_checks import problems_of_first_frame

    env = make_environment(spec)
    try:
        frame = first_frame(env, spec)
    finally:
        env.close()
    images = torch.from_numpy(np.asarray(target, np.float32)).movedim(-1, 1) / 127.5 - 1
    return problems_of_first_frame(frame, context_frame, images)
