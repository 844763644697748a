"""Checks that an environment shows the scene of a translation: what a reward from frames cannot notice by itself."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import torch

from stages.environments.timing import Timing
from stages.rewards.tracking import gaussian, motion
from stages.translation.networks import to_images

BLUR = 1 / 24  # of a frame's longer side: what moves within it does not count as another scene
MOST_UNLIKE = 1.0  # times the motion of the target; see "Faults, hostile files and footage" in results/LOG.md
MOST_STRETCHED = 1.05  # ratio of aspect ratios


def unlike(frame: np.ndarray, context_frame: np.ndarray, target: torch.Tensor) -> float:
    """Return how much a blurred frame differs from the context frame, relative to the target's motion.

    Args:
        frame, context_frame: Images (H, W, 3), uint8.
        target: The target's frames (T, 3, H, W), in [-1, 1].
    """
    shown = to_images(torch.from_numpy(np.stack([frame, context_frame])))
    one, other = gaussian(shown, BLUR * max(frame.shape[:2]))
    moved = float(motion(target[None].cpu()) / len(target))
    return float((one - other).square().sum()) / max(moved, 1e-9)


def problems_of_first_frame(frame: np.ndarray, context_frame: np.ndarray, target: torch.Tensor) -> list[str]:
    """Return what is wrong with the first frame of an episode, one line per problem.

    Args:
        frame, context_frame, target: As in `unlike`.
    """
    if frame.min() == frame.max():
        return ["the environment's first frame has one color only: check that it renders (`ifo doctor` checks OpenGL)"]
    ratio = unlike(frame, context_frame, target)
    if ratio > MOST_UNLIKE:
        return [
            f"the environment's first frame differs from the context frame {ratio:.3g} times as much as the target "
            "moves: render with the camera, crop and lighting of the context frame, or translate into this context"
        ]
    return []


def stretch_problem(shape: tuple[int, ...], size: tuple[int, int]) -> str:
    """Return what is wrong with the aspect ratio of frames (H, W, 3) that are reduced to `size`; empty: nothing."""
    stretched = (shape[1] / shape[0]) / (size[1] / size[0])
    if 1 / MOST_STRETCHED <= stretched <= MOST_STRETCHED:
        return ""
    ratio = Fraction(size[1], size[0])
    return (
        f"the environment's frames of {shape[1]}x{shape[0]} pixels are squeezed to {size[1]}x{size[0]}: crop them to "
        f"{ratio.numerator}:{ratio.denominator}, as the context frame was"
    )


def length_problem(steps: int | None, timing: Timing) -> str:
    """Return what is wrong with the length of episodes; empty: nothing.

    Args:
        steps: Steps of an episode; None: no limit is known.
        timing: The steps at which an episode shows the frames of the target.
    """
    needed = timing.frame_steps[-1]
    if steps is None or steps >= needed:
        return ""
    reached = max(j for j, step in enumerate(timing.frame_steps) if step <= steps)
    return (
        f"episodes of {steps} steps end at frame {reached} of {timing.frames - 1} of the target, which takes {needed} "
        "steps: allow longer episodes (max_episode_steps), or choose a smaller frame_every"
    )
