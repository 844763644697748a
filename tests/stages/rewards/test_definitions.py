"""Rewards equal their definitions: weights over time, tracked targets, blurring, means of terms."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from stages.environments.simulated import SimulatedMoment
from stages.environments.timing import Timing
from stages.rewards.frames import FrameReward, time_weights, tracking_cost
from stages.rewards.joints import JointsReward
from stages.rewards.state import ExpertReward, GoalReward, OracleReward, StateReward
from stages.rewards.tracking import TrackingReward, TrackingTarget, gaussian, motion
from stages.simulation.contexts import DISTRIBUTIONS
from stages.simulation.tasks.push import Push
from stages.simulation.tasks.reach import Reach
from stages.translation.networks import to_images


def test_weights_over_time_have_a_mean_of_one():
    np.testing.assert_array_equal(time_weights("none", 5), np.ones(5))
    np.testing.assert_allclose(time_weights("quadratic", 5), np.array([0, 1, 4, 9, 16]) / 6)


def test_what_is_tracked_between_two_frames_costs_nothing():
    timing = Timing.regular(7, 3)
    targets, weights = np.arange(6.0).reshape(3, 2), np.array([5.0, 0.5, 2.0])
    at, cost = tracking_cost(timing, targets, weights)
    np.testing.assert_array_equal(at, targets[[0, 0, 0, 1, 1, 1, 2, 2]])
    np.testing.assert_array_equal(cost, [0, 0, 0, 1, 0, 0, 4, 0])


def test_the_target_stays_at_the_last_frame():
    at, cost = tracking_cost(Timing.regular(8, 2), np.arange(4.0)[:, None], np.ones(4))
    np.testing.assert_array_equal(at[:, 0], [0, 0, 1, 1, 2, 2, 3, 3, 3])
    np.testing.assert_array_equal(cost, [0, 0, 2, 0, 2, 0, 2, 0, 0])


class Bright(FrameReward):
    """A reward that is how bright a frame is, and a second term."""

    def judge(self, frame, drawn):
        self.frames = [*getattr(self, "frames", []), frame]
        value = drawn.mean(axis=(1, 2, 3)).astype(float)
        self.add("twice", 2 * value)
        return value


def test_terms_are_means_over_episodes_and_simulations(stage):
    reward = Bright(stage.timing)
    assert reward.frame_period == 2 and reward.terms() == {}
    videos = np.zeros((4, 6, 16, 16, 3), np.uint8)
    videos[0, 1:], videos[1, 1:] = 100, 20
    np.testing.assert_array_equal(stage.perform(reward, videos), [[100] * 5, [20] * 5, [0] * 5, [0] * 5])
    stage.perform(reward, videos // 2)
    assert reward.frames == [1, 2, 3, 4, 5] * 2
    assert reward.terms() == {"return": pytest.approx(0.75 * 5 * 30), "twice": pytest.approx(1.5 * 5 * 30)}
    assert reward.terms() == {}
    stage.perform(reward, videos)
    assert reward.terms()["return"] == pytest.approx(150)
    assert reward.state() == {} and reward.iterate() is None and reward.restore({}) is None and reward.close() is None


def state(qpos, **values):
    zeros = np.zeros_like(qpos)
    return SimpleNamespace(qpos=qpos, qvel=zeros, site_xpos=np.zeros((len(qpos), 1, 3)), ctrl=zeros, **values)


def moment(step, of, contexts):
    return SimulatedMoment(step, of, contexts, np.zeros((len(of.qpos), 1)))


def test_a_state_rewards_return_is_the_mean_over_episodes_and_simulations():
    class Counting(StateReward):
        def reward(self, step, state, action, contexts):
            assert (action, contexts) == ("pushed", "here")
            return step * state.qpos[:, 0]

    task = SimpleNamespace(control_steps=3)
    reward = Counting(task)
    assert reward.terms() == {"return": 0.0} and reward.frame_period is None
    for _ in range(2):
        for step in (1, 2, 3):
            np.testing.assert_array_equal(
                reward(moment(step, state(np.array([[1.0], [3.0]])), "here"), "pushed"), [step, 3 * step]
            )
    assert reward.terms() == {"return": pytest.approx(12.0)}
    assert reward.terms() == {"return": 0.0}
    assert reward.state() == {} and reward.iterate() is None and reward.restore({}) is None and reward.close() is None
    reward(moment(1, state(np.array([[1.0], [3.0]])), "here"), "pushed")
    assert reward.terms() == {"return": 2.0}, "of an episode that has begun"


def test_the_oracle_judges_by_the_tasks_own_outcome():
    class Task:
        control_steps = 3

        def distance(self, state, contexts):
            return state.qpos[:, 0]

        def outcome(self, distance):
            self.seen = distance
            return distance.max(axis=1), distance.min(axis=1)

    task = Task()
    reward = OracleReward(task)
    for _ in range(2):
        given = [
            reward(moment(step, state(np.array([[at], [2 * at]])), {}), None)
            for step, at in ((1, 4.0), (2, 1.0), (3, 3.0))
        ]
        np.testing.assert_array_equal(given, [[0, 0], [0, 0], [-0.25, -0.25]])
        np.testing.assert_array_equal(task.seen[0], [4.0, 4.0, 1.0, 3.0])  # the first step stands for the start


def test_an_expert_is_paid_by_the_task():
    task = SimpleNamespace(control_steps=3, expert_reward=lambda state, action, contexts: (state, action, contexts))
    asked = ExpertReward(task).reward(2, "state", "action", "contexts")
    assert asked == ("state", "action", "contexts")


def test_the_goal_is_tracked_at_every_step_in_units_of_the_starts_error():
    from stages.simulation.batch import BatchSimulation

    task = Reach()
    contexts = task.draw_contexts(np.random.default_rng(1), 1, DISTRIBUTIONS["paper"])
    reward = GoalReward(task, contexts)
    start = BatchSimulation(task, 1, 1).reset(*task.context_state(contexts))
    error = task.goal_error(start, contexts)
    assert reward.finer is None and reward.targets.shape == (51, error.shape[1]) and not reward.targets.any()
    np.testing.assert_allclose(reward.cost_weights, np.full(51, 1 / np.square(error).sum()))
    np.testing.assert_array_equal(reward.tracked(moment(0, start, contexts)), error)


@pytest.mark.parametrize("ramp", ["none", "quadratic"])
def test_joints_are_paid_by_their_squared_distance_over_the_demonstrations_motion(ramp):
    task = Push()
    rng = np.random.default_rng(0)
    demonstration, qpos = rng.normal(size=(task.frames, 5)), rng.normal(size=(2, 5))
    reward = JointsReward(task, demonstration, ramp)
    driven = demonstration[:, :3]  # the object is not driven
    scale = np.square(driven - driven[0]).sum()
    for frame in (1, 7, task.frames - 1):
        expected = -time_weights(ramp, task.frames)[frame] * np.square(qpos[:, :3] - driven[frame]).sum(axis=1) / scale
        np.testing.assert_allclose(reward.reward(frame * task.frame_every, state(qpos), None, {}), expected)
        assert not reward.reward(frame * task.frame_every - 1, state(qpos), None, {}).any()
    assert not reward.reward(task.frames * task.frame_every, state(qpos), None, {}).any(), "no frame shows it"
    assert reward.finer is None
    np.testing.assert_array_equal(reward.tracked(moment(3, state(qpos), {})), qpos[:, :3])
    at_rest = JointsReward(task, np.zeros((task.frames, 5)))
    moved = np.full((1, 5), 1e-3)
    np.testing.assert_allclose(at_rest.reward(task.frame_every, state(moved), None, {}), -3.0)


@pytest.mark.parametrize("sigma", [0.5, 2.0, 4.3])
def test_blurring_is_scipys(sigma):
    images = torch.rand(2, 3, 20, 28, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    radius = int(np.ceil(3 * sigma))
    expected = gaussian_filter(images.numpy(), (0, 0, sigma, sigma), mode="nearest", radius=(0, 0, radius, radius))
    np.testing.assert_allclose(gaussian(images, sigma).numpy(), expected, atol=1e-12)


def test_motion_is_the_squared_distance_from_the_first_frame():
    values = torch.arange(24.0).reshape(2, 3, 2, 2).square()
    by_hand = [sum(float((video[t] - video[0]).square().sum()) for t in range(3)) for video in values]
    torch.testing.assert_close(motion(values), torch.tensor(by_hand))


def target(blur=0.0, still=False):
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(4, 3, 12, 16, generator=generator) * 2 - 1
    if still:
        images = images[:1].repeat(4, 1, 1, 1)
    return TrackingTarget(torch.randn(4, 5, generator=generator), images, 7.0, 300.0, blur)


@pytest.mark.parametrize("still", [False, True])
def test_errors_are_squared_distances_over_their_scales(still):
    generator = torch.Generator().manual_seed(1)
    features, images = torch.randn(2, 5, generator=generator), torch.rand(2, 3, 12, 16, generator=generator)
    sharp, blurred = target(0.0, still), target(2.0, still)
    assert blurred.blurs and not sharp.blurs and target(0.1).blurs and not target(0.09).blurs
    for frames in (2, torch.tensor([3, 1])):
        apart = (features - sharp.features[frames]).square().sum(dim=1)
        torch.testing.assert_close(sharp.feature_error(features, frames), apart / 7)
        plain = (images - sharp.images[frames]).square().flatten(1).sum(dim=1) / 300
        torch.testing.assert_close(sharp.image_error(images, frames), plain)
        soft = gaussian(sharp.images, 2.0)
        scale = max(float(motion(soft[None])), 0.003 * 300)
        assert not still or scale == pytest.approx(0.9)
        more = (gaussian(images, 2.0) - soft[frames]).square().flatten(1).sum(dim=1) / scale
        torch.testing.assert_close(blurred.image_error(images, frames), plain + more)
    assert len(sharp.image_parts(images)) == 1 and len(blurred.image_parts(images)) == 2
    for made, frames in ((sharp, 2), (blurred, 2)):
        parts = zip(made.image_parts(images), made.image_parts(made.images[2:3]), strict=True)
        total = sum((a - b).square().flatten(1).sum(dim=1) for a, b in parts)
        torch.testing.assert_close(total, made.image_error(images, frames), rtol=1e-4, atol=1e-5)


def test_a_target_is_read_from_a_translation_or_from_the_experts_video():
    rng = np.random.default_rng(0)
    arrays = {
        "target_features": rng.normal(size=(4, 5)).astype(np.float32),
        "target_images": rng.uniform(0, 255, (4, 12, 16, 3)).astype(np.float32),
        "expert_features": rng.normal(size=(4, 5)).astype(np.float32),
        "expert_frames": rng.integers(0, 256, (4, 12, 16, 3), dtype=np.uint8),
        "feature_scale": np.float32(3.0),
        "image_scale": np.float32(40.0),
    }
    made, expert = (TrackingTarget.of(arrays, 2.5, expert=expert) for expert in (False, True))
    assert (made.feature_scale, made.image_scale, made.blur) == (3.0, 40.0, 2.5) == (
        expert.feature_scale, expert.image_scale, expert.blur
    )  # fmt: skip
    np.testing.assert_array_equal(made.features, arrays["target_features"])
    np.testing.assert_array_equal(expert.features, arrays["expert_features"])
    np.testing.assert_allclose(made.images, np.moveaxis(arrays["target_images"], -1, 1) / 127.5 - 1, atol=1e-6)
    np.testing.assert_allclose(expert.images, np.moveaxis(arrays["expert_frames"], -1, 1) / 127.5 - 1, atol=1e-6)


class Means:
    """Features that are the means of colours."""

    def encode(self, images):
        return images.mean(dim=(2, 3))


@pytest.mark.parametrize(("without", "terms"), [((), ("feat", "img")), (("feat",), ("img",)), (("img",), ("feat",))])
def test_a_frames_reward_is_minus_its_weighted_errors(without, terms):
    images = torch.rand(4, 3, 12, 16, generator=torch.Generator().manual_seed(0)) * 2 - 1
    goal = TrackingTarget(Means().encode(images), images, 0.5, 300.0)
    frames = np.random.default_rng(0).integers(0, 256, (2, 12, 16, 3), dtype=np.uint8)
    reward = TrackingReward(Means(), goal, np.array([0.0, 1.0, 3.0, 5.0]), 0.25, without)
    assert reward.terms == terms
    got, shown = reward(frames, 2), to_images(torch.from_numpy(frames))
    expected = {
        "feat": -3.0 * goal.feature_error(Means().encode(shown), 2),
        "img": -3.0 * 0.25 * goal.image_error(shown, 2),
    }
    assert tuple(got) == terms
    for name in terms:
        assert got[name].dtype == np.float64 and got[name].shape == (2,)
        np.testing.assert_allclose(got[name], expected[name], rtol=1e-6)
