"""Makes a Gymnasium environment by name, and takes its frames."""

from __future__ import annotations

import importlib
import inspect
import math
import os
import warnings
from collections.abc import Callable
from importlib import util
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import FilterObservation, FlattenObservation, RescaleAction

from artifacts import IfoError, PlatformError, UsageError, sha256_of
from stages.config.demonstrations import Crop
from stages.environments.engine_log import log_warnings
from stages.environments.spec import EnvironmentSpec
from stages.environments.success import Judged
from stages.environments.viewpoints import Viewed, Viewpoint, make_plain, physics_of
from stages.footage.crops import reduced
from stages.simulation.blame import failure
from stages.simulation.gl import choose_backend

SUITE = "dm_control/"  # of environments that Shimmy registers
OVERSAMPLING = 2  # rendered pixels per pixel of a frame, where the size of the rendered image is ours to choose


class EnvironmentFault(UsageError):
    """The code of a user's environment failed, or it is none to learn in."""


def make_environment(spec: EnvironmentSpec, raw: bool = False) -> gymnasium.Env:
    """Make the environment, with observations as a flat array and actions in [-1, 1]; with `raw`, with its own.

    Where MuJoCo is underneath, it renders without multisampling, shadows and reflections, and, if the user chose
    neither width, height nor a crop, at twice the size of the frames.

    Raises:
        EnvironmentFault: There is no such environment, it cannot be made, or it is none to learn in.
    """
    choose_backend(required=False)  # The environment may import mujoco, which fixes its backend on import.
    log_warnings()
    try:
        env = _made(spec)
    except IfoError:
        raise
    except (Exception, SystemExit) as error:  # User code may fail in any way; none is a bug in ifo.
        raise EnvironmentFault(f"environment {spec.name}: cannot be made {_place(spec, error)}") from error
    if not isinstance(env, gymnasium.Env):
        raise EnvironmentFault(f"environment {spec.name}: is a {type(env).__name__}, expected a gymnasium.Env")
    if env.render_mode != "rgb_array":
        raise EnvironmentFault(
            f"environment {spec.name}: its render_mode is {env.render_mode!r}, expected 'rgb_array': it must return "
            "images"
        )
    if spec.success:
        env = Judged(env, _judge(spec.success))
    viewed = env = _render_fast(env, spec)
    if spec.viewpoint is not None and spec.viewpoint != Viewpoint() and not viewed.can_move:
        raise EnvironmentFault(
            f"environment {spec.name}: has no camera of MuJoCo that could be moved: leave --viewpoint out"
        )
    if raw:
        return env
    return _flat_actions(_flat_observations(env, spec), spec)


def _made(spec: EnvironmentSpec) -> Any:
    """What the name stands for."""
    module, colon, attribute = spec.name.partition(":")
    if colon and attribute.isidentifier():
        made = getattr(importlib.import_module(module), attribute, None)
        if made is None:
            raise EnvironmentFault(f"environment {spec.name}: the module {module} has no {attribute}")
        given = dict(spec.kwargs)
        if "render_mode" in inspect.signature(made).parameters:
            given.setdefault("render_mode", "rgb_array")
        return made(**given)
    if spec.name.startswith(SUITE):
        _register_suite()
    limit = {"max_episode_steps": spec.control_steps} if spec.control_steps else {}
    given = {"render_mode": "rgb_array", **spec.kwargs, **limit}
    try:
        return gymnasium.make(spec.name, **given, disable_env_checker=True)
    except gymnasium.error.UnregisteredEnv as error:
        raise EnvironmentFault(
            f"environment {spec.name}: {' '.join(str(error).split()).rstrip('.')}; if another package registers it, "
            f"name that too: --env PACKAGE:{spec.name}"
        ) from error


def _register_suite() -> None:
    """Register the environments of dm_control.

    Raises:
        PlatformError: Shimmy is not installed.
    """
    try:
        importlib.import_module("shimmy")  # Registers them.
    except ImportError as error:
        raise PlatformError("environments of dm_control need Shimmy: pip install 'shimmy[dm-control]'") from error


def module_file(name: str) -> str:
    """The file of the module in `MODULE:ATTR`; empty if there is none."""
    module, colon, attribute = name.partition(":")
    try:
        found = util.find_spec(module) if colon and attribute.isidentifier() else None
    except (ImportError, ValueError, AttributeError):
        return ""
    return found.origin if found and found.origin and os.path.isfile(found.origin) else ""


def code_digest(*names: str) -> dict[str, str]:
    """The SHA-256 of the files of users' functions, as `{"environment_code": ...}`; empty for Gymnasium IDs."""
    digests = [sha256_of(path) for path in map(module_file, names) if path]
    return {"environment_code": " ".join(digests)} if digests else {}


def _judge(name: str) -> Callable[..., Any]:
    """The function MODULE:ATTR that decides about success.

    Raises:
        EnvironmentFault: There is none, or its module fails.
    """
    module, _, attribute = name.partition(":")
    try:
        judge = getattr(importlib.import_module(module), attribute)
    except (Exception, SystemExit) as error:
        raise EnvironmentFault(f"--success {name}: cannot be loaded {failure(error, [module])}") from error
    if not callable(judge):
        raise EnvironmentFault(f"--success {name}: is a {type(judge).__name__}, expected a function")
    return judge


def episode_limit(env: gymnasium.Env) -> int | None:
    """Steps after which the environment ends an episode; None: it sets no limit."""
    wrapped: Any = env
    while isinstance(wrapped, gymnasium.Wrapper):
        if isinstance(wrapped, gymnasium.wrappers.TimeLimit):
            return int(wrapped._max_episode_steps)
        wrapped = wrapped.env
    limit = getattr(wrapped, "max_path_length", None) or (wrapped.spec and wrapped.spec.max_episode_steps)
    inner: Any = getattr(wrapped, "_env", None)
    if not limit and hasattr(inner, "control_timestep"):  # of dm_control
        seconds = getattr(inner, "_time_limit", math.inf)
        limit = getattr(inner, "_step_limit", seconds / inner.control_timestep())
    return round(limit) if limit and math.isfinite(limit) else None


def _render_fast(env: gymnasium.Env, spec: EnvironmentSpec) -> Viewed:
    """Render small images without multisampling, shadows and reflections, where MuJoCo is underneath."""
    inner: Any = env.unwrapped
    renderer: Any = getattr(inner, "mujoco_renderer", None)
    physics = physics_of(env)
    if physics is not None:
        model: Any = physics.model
        chosen = {"width", "height"} & set(getattr(inner, "render_kwargs", None) or ())
    elif renderer is not None and hasattr(renderer, "model"):
        model, chosen = renderer.model, {"width", "height"} & set(spec.kwargs)
    else:
        return Viewed(env, spec.viewpoint)
    make_plain(model)
    if spec.crop is not None or chosen:
        return Viewed(env, spec.viewpoint)
    height, width = (OVERSAMPLING * side for side in spec.size)
    if physics is not None:
        return Viewed(env, spec.viewpoint, (height, width))
    scale = max(height / renderer.height, width / renderer.width)
    if scale < 1:
        renderer.height, renderer.width = round(renderer.height * scale), round(renderer.width * scale)
    return Viewed(env, spec.viewpoint)


def _flat_observations(env: gymnasium.Env, spec: EnvironmentSpec) -> gymnasium.Env:
    space = env.observation_space
    if isinstance(space, spaces.Dict):
        states = [key for key, part in space.spaces.items() if not _is_image(part)]
        if not states:
            raise EnvironmentFault(f"environment {spec.name}: observes only images; a policy needs a state to act on")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # about infinite bounds
            return FlattenObservation(env if len(states) == len(space.spaces) else FilterObservation(env, states))
    if _is_image(space):
        raise EnvironmentFault(f"environment {spec.name}: observes an image; a policy needs a state to act on")
    return env if isinstance(space, spaces.Box) and len(space.shape) == 1 else FlattenObservation(env)


def _is_image(space: spaces.Space) -> bool:
    return isinstance(space, spaces.Box) and space.dtype == np.uint8 and len(space.shape) == 3


def _flat_actions(env: gymnasium.Env, spec: EnvironmentSpec) -> gymnasium.Env:
    space = env.action_space
    if not isinstance(space, spaces.Box) or len(space.shape) != 1 or not space.is_bounded():
        raise EnvironmentFault(f"environment {spec.name}: its actions are {space}, expected a bounded Box of one axis")
    return RescaleAction(env, np.float32(-1.0), np.float32(1.0))


def rendered(env: gymnasium.Env, spec: EnvironmentSpec) -> np.ndarray:
    """The image (H', W', 3), uint8, that the environment shows now.

    Raises:
        EnvironmentFault: It shows no image, or one that is smaller than a frame or than the crop.
    """
    image: Any = env.render()
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        shown = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise EnvironmentFault(f"environment {spec.name}: render returns {shown}, expected uint8 (H, W, 3)")
    height, width = image.shape[:2]
    if spec.crop is not None and (spec.crop.x + spec.crop.w > width or spec.crop.y + spec.crop.h > height):
        raise EnvironmentFault(
            f"environment {spec.name}: --crop {','.join(map(str, spec.crop))} extends beyond its image of "
            f"{width}x{height} pixels"
        )
    wanted = (spec.crop.h, spec.crop.w) if spec.crop is not None else (height, width)
    if wanted[0] < spec.size[0] or wanted[1] < spec.size[1]:
        raise EnvironmentFault(
            f"environment {spec.name}: its image of {wanted[1]}x{wanted[0]} pixels is smaller than a frame of "
            f"{spec.size[1]}x{spec.size[0]}: render larger images (--env-kwargs width=N --env-kwargs height=N)"
        )
    return image


def frame_of(image: np.ndarray, spec: EnvironmentSpec) -> np.ndarray:
    """The frame (H, W, 3), uint8, of a rendered image: cropped, and reduced by area averaging."""
    crop = spec.crop or Crop(0, 0, image.shape[1], image.shape[0])
    return reduced(np.ascontiguousarray(image), crop, spec.size)


def _place(spec: EnvironmentSpec, error: BaseException) -> str:
    module = spec.name.partition(":")[0] if ":" in spec.name else "gymnasium"
    return failure(error, [module])


def fault(spec: EnvironmentSpec, env: gymnasium.Env, where: str, error: BaseException) -> str:
    """One line about an exception of the environment's code, with its place."""
    if isinstance(error, EnvironmentFault):
        return str(error)
    modules = {kind.__module__ for kind in type(env.unwrapped).__mro__ if not kind.__module__.startswith("gymnasium.")}
    return f"environment {spec.name}: {where} failed {failure(error, modules - {'builtins', 'abc', 'typing'})}"
