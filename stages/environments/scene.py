"""The learner's context outside the simulated tasks: the first frame of a Gymnasium environment, or an image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from artifacts import UsageError, read_png
from stages.config.demonstrations import Crop, parse_crop
from stages.config.environments import parse_kwargs
from stages.config.stages import TranslateConfig
from stages.environments.making import EnvironmentFault, episode_limit, fault, frame_of, make_environment, rendered
from stages.environments.spec import EnvironmentSpec
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
    spec = EnvironmentSpec(config.env, kwargs, config.env_seed, config.episode_steps, frames, size, crop)
    env = make_environment(spec)
    try:
        steps = config.episode_steps or episode_limit(env)
        if not steps:
            raise UsageError(f"environment {spec.name}: sets no limit to its episodes: give --episode-steps")
        if steps < frames - 1:
            raise UsageError(
                f"environment {spec.name}: episodes of {steps} steps are too short for a target of {frames} frames: "
                f"give --episode-steps {frames - 1} or more"
            )
        spec = replace(spec, control_steps=steps)
        frame = first_frame(env, spec)
        if crop is None and _stretched(env.render(), size):
            raise UsageError(
                f"environment {spec.name}: its images have another aspect ratio than the demonstrations' frames of "
                f"{size[1]}x{size[0]}: crop them with --crop X,Y,W,H"
            )
        return spec, frame
    finally:
        env.close()


def first_frame(env: object, spec: EnvironmentSpec) -> np.ndarray:
    """The frame (H, W, 3), uint8, that an environment shows after `reset` with the context's seed.

    Raises:
        EnvironmentFault: Its code fails.
    """
    import gymnasium

    assert isinstance(env, gymnasium.Env)
    where = "reset"
    try:
        env.reset(seed=spec.seed)
        where = "render"
        return frame_of(rendered(env, spec), spec)
    except EnvironmentFault:
        raise
    except Exception as error:
        raise EnvironmentFault(fault(spec, env, where, error)) from error


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
