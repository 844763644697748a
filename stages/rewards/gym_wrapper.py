"""The translation reward for any Gymnasium environment with frames, usable with any learning library.

env = TranslationReward(gymnasium.make("ifo/Reach-v0", render_mode="rgb_array"), "runs/reach-c0.translation.h5")
"""

from __future__ import annotations

import warnings
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, SupportsFloat

import cv2
import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from artifacts import Artifact, UsageError, read_artifact
from stages.config.presets import DEFAULT_PRESET, PRESETS, defaults
from stages.config.stages import RAMPS, REWARD_TERMS, PolicyConfig
from stages.environments.spec import EnvironmentSpec
from stages.environments.timing import Timing
from stages.rewards.frames import time_weights
from stages.rewards.scene_checks import length_problem, problems_of_first_frame, stretch_problem
from stages.rewards.tracking import TrackingReward, TrackingTarget
from stages.runtime.devices import pick_device
from stages.translation.networks import load_translator


class TranslationReward(gymnasium.Wrapper, RecordConstructorArgs):
    """Replaces the reward of an environment by the reward for tracking a translated video (Sec. V.A).

    Frame j = 1 .. T-1 of the target is compared with the environment's frame after `j * frame_every` steps, or, if the
    translation was made for a Gymnasium environment, at the steps that it records. At all other steps, the reward is
    zero. An episode that terminates earlier is charged at once for the rest of the target, as if the environment had
    stood still in its last frame: ending early must not pay. `info` contains the environment's original reward,
    `env_reward`, and both weighted terms of the reward, `reward_feat` and `reward_img`.

    What the reward cannot notice is warned of, once each (`UserWarning`): a first frame that does not resemble the
    context frame, frames of one color, frames that never change during an episode, frames of another aspect ratio than
    the translator's, and episodes that are too short for the target.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        translation: str | Path,
        frame_every: int | None = None,
        without: Collection[str] = (),
        image_weight: float | None = None,
        blur: float | None = None,
        ramp: str | None = None,
        device: str = "cpu",
        pixels: str | None = None,
    ):
        """Track the target of a translation, whose context is simulated, an environment or an image.

        Args:
            env: Environment to learn in; its frames must show the context of the translation.
            translation: Path of the `translation` artifact; the translator that it was made with must exist.
            frame_every: Steps between two frames (None: as in the task or environment of the translation).
            without: Terms to switch off: `feat` or `img`.
            image_weight: Weight w_rec of R_img (None: default of `ifo learn-policy`).
            blur: Standard deviation, in pixels, of the Gaussian blur under which R_img also compares images (None:
                default of `ifo learn-policy`).
            ramp: Weighting of frames over time: `none`, `quadratic`, or `task` for the paper's choice for the task
                (None: default of `ifo learn-policy`).
            device: `auto`, `cpu`, `cuda` or `cuda:N`.
            pixels: Key of the observation with frames (H, W, 3), uint8 (None: frames are rendered by `env.render`).
                Frames larger than those of the translator are reduced to its size by area averaging.

        Raises:
            ArtifactError: The translation or its translator is missing or damaged.
            PlatformError: The device is not available.
            UsageError: The environment has no frames, or its frames are too small, or frame_every is missing, or
                another argument is invalid.
        """
        RecordConstructorArgs.__init__(
            self,
            translation=str(translation),
            frame_every=frame_every,
            without=tuple(without),
            image_weight=image_weight,
            blur=blur,
            ramp=ramp,
            device=device,
            pixels=pixels,
        )
        gymnasium.Wrapper.__init__(self, env)
        target = Target.of(translation, frame_every, without, image_weight, blur, ramp, device)
        self._target = target
        self._size, self._timing = target.size, target.timing
        self._reward = target.reward
        self._pixels = pixels
        self._warned: set[str] = set()
        self._checked = False
        self._step = 0
        self._moved = False
        self._check_shown()
        steps = None if env.spec is None else env.spec.max_episode_steps
        self._warn(length_problem(steps, self._timing))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode at frame 0 of the target."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._step = 0
        self._moved = False
        if not self._checked:  # Check the result of `render` here, the earliest point at which it is available.
            self._first = self._shown(observation)
            for problem in problems_of_first_frame(self._first, self._target.context_frame, self._reward.target.images):
                self._warn(problem)
            self._checked = True
        return observation, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Take `action` and return the reward for how closely the next frame follows the target."""
        observation, env_reward, terminated, truncated, info = self.env.step(action)
        self._step += 1
        terms = dict.fromkeys(REWARD_TERMS, 0.0)
        frame = self._timing.frame_at(self._step)
        compared = [] if frame is None else [frame]
        if terminated:
            compared += (j for j, step in enumerate(self._timing.frame_steps) if step > self._step)
        if compared:
            shown = self._shown(observation)
            self._check_motion(shown, last=frame == self._timing.frames - 1)
            for index in compared:
                for term, values in self._reward(shown[None], index).items():
                    terms[term] += float(values[0])
        if truncated and not terminated:
            self._warn(length_problem(self._step, self._timing))
        info = {**info, "env_reward": env_reward, **{f"reward_{term}": value for term, value in terms.items()}}
        return observation, sum(terms.values()), terminated, truncated, info

    def _check_motion(self, shown: np.ndarray, last: bool) -> None:
        """Warn if all frames up to the end of the target equal the first one of the first episode."""
        self._moved |= not np.array_equal(shown, self._first)
        if not self._moved and last:
            self._warn(
                "the environment's frames do not change during an episode: check that it renders (`ifo doctor` checks "
                "OpenGL), and that the camera shows what moves"
            )

    def _warn(self, problem: str) -> None:
        """Warn of a problem unless it is empty, or its kind was warned of before."""
        kind = problem.partition(":")[2]
        if problem and kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(f"TranslationReward: {problem}", stacklevel=3)

    def _shown(self, observation: Any) -> np.ndarray:
        """Current frame of the environment (H, W, 3), uint8, at the size of the translator's frames."""
        image: Any = self.env.render() if self._pixels is None else observation[self._pixels]
        checked = checked_image(image)
        self._check_size(checked.shape)
        self._warn(stretch_problem(checked.shape, self._size))
        return reduced_to(checked, self._size)

    def _check_shown(self) -> None:
        """Reject environments without frames, as far as this is possible before the first episode."""
        if self._pixels is None:
            if self.env.render_mode != "rgb_array":
                raise UsageError(
                    f"TranslationReward: the environment's render_mode is {self.env.render_mode!r}, expected "
                    "'rgb_array'; create it with that render_mode, or set pixels= to the observation key with frames"
                )
            return
        space = self.env.observation_space
        images = {
            name: part.shape
            for name, part in (space.spaces.items() if isinstance(space, gymnasium.spaces.Dict) else ())
            if isinstance(part, gymnasium.spaces.Box) and part.dtype == np.uint8 and part.shape[2:] == (3,)
        }
        if self._pixels not in images:
            there = f"keys with images: {', '.join(images)}" if images else "no key has images"
            raise UsageError(
                f"TranslationReward: pixels={self._pixels!r}: expected a key of a dict observation with images "
                f"(H, W, 3), uint8; {there}"
            )
        self._check_size(images[self._pixels])

    def _check_size(self, shape: tuple[int, ...]) -> None:
        check_size(shape, self._size)


@dataclass(frozen=True)
class Target:
    """What a translation's reward tracks, and how.

    Attributes:
        reward: The reward for single frames.
        context_frame: The context frame (H, W, 3), uint8.
        timing: The steps at which an episode shows the frames of the target.
    """

    reward: TrackingReward
    context_frame: np.ndarray
    timing: Timing

    @property
    def frames(self) -> int:
        """Number of frames T."""
        return len(self.reward.target.images)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a frame."""
        shape = self.reward.target.images.shape
        return int(shape[2]), int(shape[3])

    @classmethod
    def of(
        cls,
        translation: str | Path,
        frame_every: int | None = None,
        without: Collection[str] = (),
        image_weight: float | None = None,
        blur: float | None = None,
        ramp: str | None = None,
        device: str = "cpu",
    ) -> Target:
        """Load the target of a translation; see `TranslationReward` for the arguments.

        Raises:
            ArtifactError, PlatformError, UsageError: As `TranslationReward`.
        """
        source = read_artifact(translation, "translation")
        learning = _learning(source)
        device = pick_device(device)
        target = TrackingTarget.of(source, learning.blur if blur is None else blur, device)
        timing = _timing(source, len(target.images), frame_every)
        reward = TrackingReward(
            load_translator(source.parent("translator", check=True), device),
            target,
            time_weights(_ramp(source, ramp or learning.ramp), len(target.images)),
            learning.image_weight if image_weight is None else image_weight,
            _without(without),
            device,
        )
        return cls(reward, source["context_frame"], timing)


def checked_image(image: Any) -> np.ndarray:
    """Return `image` if it is one (H, W, 3), uint8.

    Raises:
        UsageError: It is not.
    """
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise UsageError("TranslationReward: the environment returns no RGB image, expected uint8 of (H, W, 3)")
    return image


def check_size(shape: tuple[int, ...], size: tuple[int, int]) -> None:
    """Refuse images smaller than frames of `size` (H, W).

    Raises:
        UsageError: They are.
    """
    if shape[0] < size[0] or shape[1] < size[1]:
        raise UsageError(
            f"TranslationReward: the environment's frames have {shape[1]}x{shape[0]} pixels, expected "
            f"{size[1]}x{size[0]} (the translator's size) or more"
        )


def reduced_to(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Reduce an image (H', W', 3), uint8, to a frame of `size` (H, W) by area averaging."""
    if image.shape[:2] == size:
        return np.ascontiguousarray(image)  # `render` may return a flipped view.
    return cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA)


def _learning(source: Artifact) -> PolicyConfig:
    """The default configuration of learn-policy for this translation."""
    from stages.simulation.registry import task_defaults

    preset, task = source.config.get("preset"), source.config.get("task") or ""
    preset = preset if preset in PRESETS else DEFAULT_PRESET
    return defaults(preset, "learn-policy", task, own=task_defaults(task))


def _timing(source: Artifact, frames: int, frame_every: int | None) -> Timing:
    """The steps of the frames: every `frame_every` steps; None: as in the translation's task or environment."""
    from stages.simulation.registry import make_task

    spec = EnvironmentSpec.recorded(source) if frame_every is None else None
    if spec is not None:
        return Timing.spread(spec.control_steps, frames)
    if frame_every is None and not source.config.get("task"):
        raise UsageError(
            f"TranslationReward: {source.path} has no simulated task; set the number of steps between two frames with "
            "frame_every="
        )
    every = make_task(source.config["task"]).frame_every if frame_every is None else frame_every
    if every < 1:
        raise UsageError(f"frame_every={every}: expected at least 1 step between two frames")
    return Timing.regular((frames - 1) * every + 1, every)


def _ramp(source: Artifact, ramp: str) -> str:
    """Resolve `ramp`: "task" becomes the ramp of the task, or "none" if there is no simulated task."""
    from stages.simulation.registry import make_task

    if ramp not in RAMPS:
        raise UsageError(f"TranslationReward: ramp={ramp!r}: expected one of {', '.join(RAMPS)}")
    if ramp != "task":
        return ramp
    return make_task(source.config["task"]).ramp if source.config.get("task") else "none"


def _without(without: Collection[str]) -> tuple[str, ...]:
    """Check that `without` is a collection of terms that leaves at least one term.

    Raises:
        UsageError: A term is unknown, or none is left.
    """
    terms = (without,) if isinstance(without, str) else tuple(without)
    if not set(terms) < set(REWARD_TERMS):
        raise UsageError(f"TranslationReward: without={terms}: expected at most one of {', '.join(REWARD_TERMS)}")
    return terms
