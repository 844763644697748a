"""The translation reward for vector environments of Gymnasium: frames of all environments are encoded in batches."""

from __future__ import annotations

import warnings
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from artifacts import UsageError
from stages.config.stages import REWARD_TERMS
from stages.rewards.gym_wrapper import Target, check_size, checked_image, reduced_to
from stages.rewards.scene_checks import length_problem, problems_of_first_frame, stretch_problem


class TranslationRewardVector(VectorWrapper):
    """`TranslationReward` for n environments of a vector environment, which need not be in the same step.

    `info` contains, per environment (n,), the environment's own reward, `env_reward`, and both weighted terms,
    `reward_feat` and `reward_img`. Warnings are those of `TranslationReward`, each once.
    """

    def __init__(
        self,
        env: VectorEnv,
        translation: str | Path,
        frame_every: int | None = None,
        without: Collection[str] = (),
        image_weight: float | None = None,
        blur: float | None = None,
        ramp: str | None = None,
        device: str = "cpu",
    ):
        """Track the target of a translation in every environment.

        Args:
            env: Vector environment with render_mode "rgb_array"; its frames must show the context of the translation.
            translation, frame_every, without, image_weight, blur, ramp, device: As for `TranslationReward`.

        Raises:
            ArtifactError, PlatformError: As `TranslationReward`.
            UsageError: As `TranslationReward`, or the vector environment resets environments in the same step in which
                they end, when their last frame cannot be rendered any more.
        """
        super().__init__(env)
        mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        if mode == AutoresetMode.SAME_STEP:
            raise UsageError(
                "TranslationRewardVector: the vector environment resets in the step in which an episode ends, so its "
                "last frame cannot be seen: make it with autoreset_mode NEXT_STEP or DISABLED"
            )
        if env.render_mode != "rgb_array":
            raise UsageError(
                f"TranslationRewardVector: the render_mode is {env.render_mode!r}, expected 'rgb_array'; create the "
                "environments with that render_mode"
            )
        self._resets_next = mode == AutoresetMode.NEXT_STEP
        self._target = Target.of(translation, frame_every, without, image_weight, blur, ramp, device)
        self._steps = np.zeros(env.num_envs, int)
        self._ended = np.zeros(env.num_envs, bool)
        self._warned: set[str] = set()
        self._checked = False
        spec = env.spec
        limit = None if spec is None else spec.max_episode_steps
        self._warn(length_problem(limit, self._target.timing))

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start episodes at frame 0 of the target; with `options["reset_mask"]`, only those of the mask."""
        mask = np.broadcast_to((options or {}).get("reset_mask", True), self.num_envs)  # The environment removes it.
        observation, info = self.env.reset(seed=seed, options=options)
        self._steps[mask] = 0
        self._ended[mask] = False
        if not self._checked:
            self._checked = True
            for frame in self._frames(np.arange(self.num_envs)):
                for problem in problems_of_first_frame(
                    frame, self._target.context_frame, self._target.reward.target.images
                ):
                    self._warn(problem)
        return observation, info

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take `actions` and return the rewards (n,) for how closely the next frames follow the target."""
        observation, env_reward, terminated, truncated, info = self.env.step(actions)
        begun = self._ended if self._resets_next else np.zeros(self.num_envs, bool)
        self._steps = np.where(begun, 0, self._steps + 1)
        terms = {term: np.zeros(self.num_envs) for term in REWARD_TERMS}
        target = self._target
        frame_steps = np.array(target.timing.frame_steps)
        due = ~begun & np.isin(self._steps, frame_steps)
        cut = ~begun & terminated & (self._steps < frame_steps[-1])
        seen = np.flatnonzero(due | cut)
        if len(seen):
            shown = dict(zip(seen.tolist(), self._frames(seen), strict=True))
            for index, step in enumerate(target.timing.frame_steps[1:], 1):
                at = [k for k in shown if self._steps[k] == step or (cut[k] and self._steps[k] < step)]
                if at:
                    for term, values in target.reward(np.stack([shown[k] for k in at]), index).items():
                        terms[term][at] += values
        for steps in self._steps[truncated & ~terminated]:
            self._warn(length_problem(int(steps), target.timing))
        self._ended = terminated | truncated
        told = {"env_reward": env_reward, **{f"reward_{term}": values for term, values in terms.items()}}
        return observation, np.sum(list(terms.values()), axis=0), terminated, truncated, {**info, **told}

    def _frames(self, indices: np.ndarray) -> list[np.ndarray]:
        """Frames (H, W, 3), uint8, of the environments with these indices, at the size of the translator."""
        images: Any = self.env.render()
        frames = []
        for index in indices:
            image = checked_image(images[index])
            check_size(image.shape, self._target.size)
            self._warn(stretch_problem(image.shape, self._target.size))
            frames.append(reduced_to(image, self._target.size))
        return frames

    def _warn(self, problem: str) -> None:
        """Warn of a problem unless it is empty, or its kind was warned of before."""
        kind = problem.partition(":")[2]
        if problem and kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(f"TranslationRewardVector: {problem}", stacklevel=3)
