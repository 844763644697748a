"""Quality of a tracking reward before reinforcement learning: how well it ranks states and episodes by progress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.stats import kendalltau

from stages.rewards.frames import time_weights
from stages.rewards.tracking import TrackingTarget
from stages.simulation.batch import HELD, drawn_actions, held, rollout
from stages.simulation.contexts import Contexts, repeat
from stages.simulation.render import RenderPool
from stages.simulation.task import State, Task
from stages.translation.networks import Translator, to_images

EPISODES = 8  # episodes per kind
NOISE = (0.3, 0.6, 1.0)  # scales of the action noise in noisy episodes, relative to `noise`, used in turn
WAY = np.linspace(0.0, 1.0, 11)  # shares of the expert's motion
PROGRESS_DIGITS = 2  # progress is rounded to hundredths of the initial distance, to ignore trembling at the goal

Act = Callable[[State, Contexts], np.ndarray]


@dataclass(frozen=True)
class Quality:
    """Measured quality of a reward.

    Attributes:
        metrics: `tau_KIND`: Kendall's tau-b along an episode between progress and nearness to the last frame of the
            target, mean over episodes of a kind (expert, noisy, random). `tau_returns`: tau-b over all episodes between
            the return and the negative final distance. `tau_way`: tau-b between a share of the expert's motion (of the
            actuated joints), from standing still to the complete motion, and its return; it shows whether the reward
            leads along this motion. `return_KIND`: mean returns. Returns use the ramp of the task. A tau is NaN if
            reward or progress never changes.
        curves: `KIND/feat` and `KIND/img`: rewards (n, T) of both terms. `KIND/distance`: normalized distances (n, T).
            `way/feat` and `way/img`: rewards (11, T) for shares 0, 0.1, ... 1 of the expert's motion.
    """

    metrics: dict[str, float]
    curves: dict[str, np.ndarray]


def reward_quality(
    task: Task,
    context: Contexts,
    begin: Callable[[Contexts, np.random.Generator | None], Act],
    model: Translator,
    target: TrackingTarget,
    pool: RenderPool,
    rng: np.random.Generator,
    image_weight: float,
    device: str = "cpu",
    noise: float = 1.0,
) -> Quality:
    """Roll out the expert, a noisy expert and random actions in one context; compare rewards with true distances.

    Args:
        task: The task.
        context: The learner's context (leading axis 1).
        begin: Function that returns the expert's actions in given contexts. With a generator, they vary between
            demonstrations.
        model: The translator.
        target: Target of the reward.
        pool: Render processes of the task.
        rng: Generator for initial states, noise and random actions.
        image_weight: Weight w_rec of R_img.
        device: Torch device of the model and the target.
        noise: Standard deviation of action noise with which the expert fails.
    """
    curves: dict[str, np.ndarray] = {}
    metrics: dict[str, float] = {}
    returns, outcomes = [], []

    def total(feat: np.ndarray, img: np.ndarray) -> np.ndarray:
        """Returns (n,) of episodes with terms (n, T)."""
        return ((feat + image_weight * img) * time_weights(task.ramp, task.frames))[:, 1:].sum(axis=1)

    contexts = repeat(context, EPISODES)
    for kind, act in _actors(task, begin(contexts, rng), noise, rng).items():
        episodes = rollout(task, contexts, *task.draw_states(rng, contexts), act=act, nthread=1)
        feat, img, nearness = _rewards(
            task, context, episodes.frame_qpos(task), model, target, pool, image_weight, device
        )
        distance = episodes.distance[:, : task.control_steps : task.frame_every]
        distance = distance / np.maximum(episodes.initial_distance[:, None], 1e-9)
        curves |= {f"{kind}/feat": feat, f"{kind}/img": img, f"{kind}/distance": distance}
        metrics[f"tau_{kind}"] = _mean([_tau(n[1:], -d[1:]) for n, d in zip(nearness, distance, strict=True)])
        returns.append(total(feat, img))
        metrics[f"return_{kind}"] = float(returns[-1].mean())
        outcomes.append(episodes.normalised_distance)
    path = rollout(task, context, *task.context_state(context), act=begin(context, None), nthread=1).frame_qpos(task)
    part = np.repeat(path[:, :1], task.frames, axis=1).repeat(len(WAY), axis=0)
    driven = task.posture
    part[..., driven] += WAY[:, None, None] * (path - path[:, :1])[..., driven]
    part[-1] = path[0]  # Joints without motors move only in the complete motion.
    feat, img, _ = _rewards(task, context, part, model, target, pool, image_weight, device)
    curves |= {"way/feat": feat, "way/img": img}
    metrics["tau_way"] = _tau(total(feat, img), WAY)
    metrics["tau_returns"] = _tau(np.concatenate(returns), -np.concatenate(outcomes))
    return Quality(metrics, curves)


def _actors(task: Task, expert: Act, scale: float, rng: np.random.Generator) -> dict[str, Act]:
    """Actions of the expert, of a noisy expert, and random actions."""
    shape = (-(-task.control_steps // HELD), EPISODES, task.action_size)
    noise = held(rng.normal(size=shape) * np.resize(NOISE, EPISODES)[:, None] * scale, task)
    return {
        "expert": expert,
        "noisy": lambda state, contexts: expert(state, contexts) + noise(state, contexts),
        "random": held(drawn_actions(rng, task, EPISODES), task),
    }


@torch.no_grad()
def _rewards(
    task: Task,
    context: Contexts,
    qpos: np.ndarray,
    model: Translator,
    target: TrackingTarget,
    pool: RenderPool,
    image_weight: float,
    device: str,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """R_feat and R_img (n, T) for joint positions (n, T, nq) in one context, and the reward for the last target frame.

    The last is the sum of both terms (n, T) with the last frame of the target as target at all times.
    """
    frames = pool.render(task.model_fields(repeat(context, len(qpos))), qpos)
    feat, img, near = [], [], []
    for video in frames:
        images = to_images(torch.from_numpy(video)).to(device)
        features, times = model.encode(images), torch.arange(len(images))
        last = torch.full_like(times, len(images) - 1)
        terms = [(-target.feature_error(features, at), -target.image_error(images, at)) for at in (times, last)]
        feat.append(terms[0][0].cpu().numpy())
        img.append(terms[0][1].cpu().numpy())
        near.append((terms[1][0] + image_weight * terms[1][1]).cpu().numpy())
    return np.stack(feat), np.stack(img), np.stack(near)


def _tau(reward: np.ndarray, progress: np.ndarray) -> float:
    """Kendall's tau-b of reward and rounded progress; NaN if one of them never changes."""
    return float(kendalltau(reward, np.round(progress, PROGRESS_DIGITS)).statistic)


def _mean(values: list[float]) -> float:
    """Mean of all values that are not NaN; NaN if there are none."""
    numbers = [value for value in values if not np.isnan(value)]
    return float(np.mean(numbers)) if numbers else float("nan")


def shown_tau(value: float) -> str:
    """Format a tau for messages."""
    return "undefined" if np.isnan(value) else f"{value:.2f}"
