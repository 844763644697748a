"""The figures that judge a reward without reinforcement learning tell a good target from a bad one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.stats import kendalltau

from stages.reporting.plots import plot_quality
from stages.rewards.quality import EPISODES, WAY, reward_quality
from stages.rewards.tracking import TrackingTarget, motion
from stages.simulation.batch import BatchSimulation, rollout
from stages.simulation.registry import distribution, make_task
from stages.simulation.render import RenderPool
from stages.translation.networks import make_translator, to_images

pytestmark = pytest.mark.gl
# Held for an episode; the goal will be where it brings the hand. A small motion: once the arm in two frames does not
# overlap, pixels do not tell near from far.
ACTION = np.array([-0.1, 0.0, 0.0])


def act(state, contexts):
    return np.tile(ACTION, (len(state.qpos), 1))


@pytest.fixture(scope="module")
def scene():
    """Task, context and network; the goal lies where ACTION brings the hand."""
    task = make_task("reach")
    context = task.draw_contexts(np.random.default_rng(0), 1, distribution("fixed"))
    simulation = BatchSimulation(task, 1)
    state = simulation.reset(*task.context_state(context))
    for _ in range(task.control_steps):
        state = simulation.step(act(state, context))
    context["goal"] = state.site_xpos[:, 0, :2]
    torch.manual_seed(0)
    return task, context, make_translator("compact", task.frame_size)


@pytest.fixture(scope="module")
def quality(scene):
    """A function (target frames (T, H, W, 3) from the true ones) -> Quality."""
    task, context, model = scene
    with RenderPool.of(task, 1) as pool:
        episode = rollout(task, context, *task.context_state(context), act=act)
        truth = pool.render(task.model_fields(context), episode.frame_qpos(task))[0]

        def judge(change, image_weight=1.0):
            images, moving = (to_images(torch.from_numpy(video.copy())) for video in (change(truth), truth))
            with torch.no_grad():
                features = model.encode(images)
                scales = float(motion(model.encode(moving)[None])), float(motion(moving[None]))
            target = TrackingTarget(features, images, *scales)
            return reward_quality(
                task, context, lambda contexts, rng: act, model, target, pool, np.random.default_rng(1), image_weight
            )

        yield judge


def test_the_true_video_as_target_ranks_progress(quality):
    metrics = quality(lambda truth: truth).metrics
    assert metrics["tau_expert"] > 0.8
    assert metrics["tau_returns"] > 0.5
    assert metrics["return_expert"] > metrics["return_noisy"] > metrics["return_random"]
    assert metrics["tau_way"] > 0.9


def test_a_target_that_stands_still_ranks_it_the_wrong_way(quality):
    metrics = quality(lambda truth: np.repeat(truth[:1], len(truth), axis=0)).metrics
    assert metrics["tau_expert"] < -0.5
    assert metrics["tau_way"] < -0.9


def test_curves_hold_every_episode_and_frame(scene, quality):
    task = scene[0]
    judged = quality(lambda truth: truth)
    for kind in ("expert", "noisy", "random"):
        for name in ("feat", "img", "distance"):
            assert judged.curves[f"{kind}/{name}"].shape == (EPISODES, task.frames)
        assert judged.curves[f"{kind}/distance"][:, 0] == pytest.approx(1.0)
        assert (judged.curves[f"{kind}/feat"] <= 0).all()
    assert judged.curves["way/img"].shape == (len(WAY), task.frames)
    assert judged.curves["way/img"][-1] == pytest.approx(0.0, abs=1e-5), "all of the expert's motion is the target"
    assert plot_quality(judged.curves).startswith(b"\x89PNG")


def test_the_same_generator_gives_the_same_figures(quality):
    assert quality(lambda truth: truth).metrics == quality(lambda truth: truth).metrics


@pytest.mark.parametrize(("ramp", "weights"), [("none", np.ones(25)), ("quadratic", np.arange(25) ** 2 / 196)])
def test_returns_are_weighted_over_time_as_the_learners_will_be(scene, quality, monkeypatch, ramp, weights):
    """196 is the mean of 0, 1, 4, ... 576: the ramp's weights are one on average."""
    task = scene[0]
    monkeypatch.setattr(task, "ramp", ramp)
    judged = quality(lambda truth: truth, image_weight=0.25)

    def total(kind):
        reward = judged.curves[f"{kind}/feat"] + 0.25 * judged.curves[f"{kind}/img"]
        return (reward * weights)[:, 1:].sum(axis=1)

    returns = []
    for kind in ("expert", "noisy", "random"):
        returns.append(total(kind))
        assert judged.metrics[f"return_{kind}"] == pytest.approx(returns[-1].mean(), rel=1e-6)
    assert judged.metrics["tau_way"] == pytest.approx(kendalltau(total("way"), np.linspace(0, 1, 11)).statistic)
    assert judged.metrics["tau_returns"] > 0.5
