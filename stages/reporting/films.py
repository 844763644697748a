"""Videos of policies, for people: larger and better drawn than the frames that are learned from, with captions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing

import numpy as np

from artifacts import caption
from artifacts.video import upscale
from stages.environments.foreign import ForeignEnvironment
from stages.environments.playing import play
from stages.environments.scene import picture_spec
from stages.environments.spec import EnvironmentSpec
from stages.learners.policy import Policy
from stages.rewards.own import OwnReward
from stages.simulation.batch import rollout
from stages.simulation.contexts import Contexts
from stages.simulation.render import TileRenderer
from stages.simulation.task import Task

SIDE = 240  # pixels, minimum height of a picture without its caption
COUNTER = 0.46  # share of a caption's width that the frame counter gets


def film_task(task: Task, policy: Policy, contexts: Contexts) -> np.ndarray:
    """Film one deterministic episode from the initial state of the context.

    Returns:
        Pictures (T, H', W', 3), uint8, at the times of the task's frames, with shadows and multisampling. Captions
        show the frame's number and the normalized distance: what it would be if the episode ended there.
    """
    episode = rollout(
        task, contexts, *task.context_state(contexts), lambda state, _: policy.act(task.observe(state)), 1
    )
    factor = factor_for(task.frame_size[0])
    height, width = (side * factor for side in task.frame_size)
    with closing(TileRenderer(task.model, height, width, task.camera, fine=True)) as renderer:
        pictures = renderer.render(task.model_fields(contexts), episode.frame_qpos(task))[0]
    outcomes = [
        task.outcome(episode.distance[:, : step + 1]) for step in range(0, task.control_steps, task.frame_every)
    ]
    return captioned(pictures, [f"distance {(final / initial).item():.2f}" for initial, final in outcomes])


def film_environment(spec: EnvironmentSpec, policy: Policy) -> np.ndarray:
    """Film one deterministic episode in a Gymnasium environment.

    Returns:
        Pictures (T, H', W', 3), uint8, at the times of the frames, in the environment's own rendering. Captions show
        the frame's number and how the episode ends: whether it succeeds, or its return if that is not known.

    Raises:
        EnvironmentFault: The environment's code fails.
    """
    with closing(ForeignEnvironment(picture_spec(spec, factor_for(spec.size[0])), 1, 1, OwnReward())) as env:
        pictures = play(env, policy.act)[0]
        outcome = {name: values.item() for name, values in env.pop_outcomes().items()}
    if "success" in outcome:
        ending = "succeeds" if outcome["success"] else "fails"
    else:
        ending = f"return {outcome['env_return']:.4g}"
    return captioned(enlarged(pictures), [ending] * len(pictures))


def factor_for(height: int) -> int:
    """The smallest integer factor that makes frames of a height, in pixels, at least `SIDE` high."""
    return max(1, math.ceil(SIDE / height))


def enlarged(frames: np.ndarray) -> np.ndarray:
    """Enlarge frames (T, H, W, 3) to at least `SIDE` pixels in height, nearest neighbor."""
    return upscale(frames, factor_for(frames.shape[1]))


def captioned(pictures: np.ndarray, notes: Sequence[str] = ()) -> np.ndarray:
    """Add a line with the frame's number, and with its note if there are any, below each picture (T, H, W, 3)."""
    count, width = len(pictures), pictures.shape[2]
    left = round(width * COUNTER) if notes else width
    lines = []
    for k in range(count):
        number = f"frame {k + 1}/{count}"
        lines.append(caption([number, notes[k]], [left, width - left]) if notes else caption([number], [width]))
    return np.concatenate([pictures, np.stack(lines)], axis=1)
