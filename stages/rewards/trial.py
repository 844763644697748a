"""A trial of the reward in a Gymnasium environment before any learning, without an expert.

The target must be ranked above standing still and above random actions; otherwise a policy that follows the reward
does not follow the target.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stages.config.presets import defaults
from stages.environments.foreign import ForeignEnvironment
from stages.environments.playing import Act, play
from stages.rewards.frames import time_weights
from stages.rewards.own import OwnReward
from stages.rewards.tracking import TrackingReward, TrackingTarget, motion
from stages.runtime.seeding import generator
from stages.simulation.batch import HELD

if TYPE_CHECKING:
    from stages.environments.protocol import Environment
    from stages.environments.spec import EnvironmentSpec
    from stages.translation.networks import Translator

RANDOM = 3  # episodes of random actions
LEAST_MOTION = 0.1  # of the target, relative to the demonstrations' motion
MARGIN = 0.1  # by which the target's return must exceed another one, relative to the other one's size


@dataclass(frozen=True)
class Trial:
    """Returns under the tracking reward; 0 is perfect, and standing still returns about -1 per distance.

    Attributes:
        target: Return of the target itself.
        still: Return of an episode of zero actions.
        random: Highest return of episodes of random actions.
        target_motion: Motion of the target's images, relative to that of the demonstrations.
        changes: Whether any frame of any episode differs from the first one.
    """

    target: float
    still: float
    random: float
    target_motion: float
    changes: bool

    @property
    def metrics(self) -> dict[str, float]:
        """The figures by name."""
        return {
            "return_target": self.target,
            "return_still": self.still,
            "return_random": self.random,
            "target_motion": self.target_motion,
        }

    def lines(self) -> list[str]:
        """The figures in one line, then the problems."""
        figures = (
            f"return of the target {self.target:.2f}, of standing still {self.still:.2f}, of random actions "
            f"{self.random:.2f} (0 is perfect); the target moves {self.target_motion:.2f} times as much as the "
            "demonstrations"
        )
        return [figures, *self.problems()]

    def problems(self) -> list[str]:
        """What will keep a policy from learning, one line each, with what to do."""
        found = []
        if not self.changes:
            found.append(
                "the environment's frames do not change during episodes: check that its camera shows what moves "
                "(`ifo doctor` checks OpenGL)"
            )
        if self.target_motion < LEAST_MOTION:
            found.append(
                f"the target moves {self.target_motion:.2f} times as much as the demonstrations: the translator does "
                "not know this scene; train it on demonstrations from more viewpoints, or choose another --env-seed "
                "or --crop"
            )
        for name, value in (("standing still", self.still), ("random actions", self.random)):
            if self.target - value <= MARGIN * abs(value):
                found.append(
                    f"the reward ranks {name} ({value:.2f}) as high as the target ({self.target:.2f}): a policy will "
                    "probably not learn from it; look at the translation's video, and check the camera, --crop and "
                    "the translator"
                )
        return found


def try_environment(
    spec: EnvironmentSpec,
    model: Translator,
    arrays: dict[str, np.ndarray],
    preset: str,
    seed: int,
    device: str,
) -> Trial:
    """Hold a trial in a Gymnasium environment, with the reward that learn-policy will use.

    Args:
        spec: The environment.
        model: The translator.
        arrays: Datasets of the translation.
        preset: Name of the preset.
        seed: Seed of the random actions.
        device: Torch device of the model.
    """
    learning = defaults(preset, "learn-policy")
    with closing(ForeignEnvironment(spec, 1, 1, OwnReward())) as env:
        return hold_trial(env, model, arrays, learning.blur, learning.image_weight, seed, device)


def hold_trial(
    env: Environment,
    model: Translator,
    arrays: dict[str, np.ndarray],
    blur: float,
    image_weight: float,
    seed: int,
    device: str,
) -> Trial:
    """Play a few episodes in `env` and rate them.

    Args:
        env: The environment.
        model: The translator.
        arrays: Datasets of the translation.
        blur: Blur of R_img, as learn-policy will use it.
        image_weight: Weight of R_img.
        seed: Seed of the random actions.
        device: Torch device of the model.
    """
    target = TrackingTarget.of(arrays, blur, device)
    reward = TrackingReward(model, target, time_weights("none", env.timing.frames), image_weight, (), device)

    def rated(videos: np.ndarray) -> np.ndarray:
        """Returns (n,) of videos (n, T, H, W, 3), uint8."""
        terms = [reward(videos[:, frame], frame) for frame in range(1, videos.shape[1])]
        return np.sum([value for each in terms for value in each.values()], axis=0)

    rng = generator(seed, "trial")
    still = play(env, lambda seen: np.zeros((len(seen), env.action_size), np.float32))
    random = [play(env, _held(rng, env)) for _ in range(RANDOM)]
    seen = np.concatenate([still, *random])
    shown = np.clip(arrays["target_images"], 0, 255).round().astype(np.uint8)
    moved = float(motion(target.images[None].cpu())) / max(target.image_scale, 1e-12)
    return Trial(
        float(rated(shown[None])[0]),
        float(rated(still).max()),
        float(max(rated(video).max() for video in random)),
        moved,
        bool((seen != seen[:, :1]).any()),
    )


def _held(rng: np.random.Generator, env: Environment) -> Act:
    """Uniform random actions, each held for a few steps: noise that changes at every step would average out."""
    actions = rng.uniform(-1, 1, (-(-env.timing.control_steps // HELD), env.num_envs, env.action_size))
    steps = iter(range(env.timing.control_steps))
    return lambda observation: actions[next(steps) // HELD].astype(np.float32)
