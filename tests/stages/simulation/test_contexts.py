"""What contexts vary in, and that every one of them can be solved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from artifacts import UsageError
from stages.simulation import reach
from stages.simulation.contexts import DISTRIBUTIONS, FACTORS, camera_pose, draw_colours, repeat, take
from stages.simulation.tasks import distribution, make_task

N = 2000
SHOWN_BY = {
    "azimuth": ("azimuth",),
    "colour": ("table_rgb", "arm_rgb"),
    "distractors": ("distractor_visible",),
    "goal": ("goal",),
    "initial": ("initial_qpos",),
}


def test_paper_contexts_see_the_scene_from_all_round(draw):
    counts, _ = np.histogram(draw("paper", N)["azimuth"], bins=12, range=(0, 360))
    assert counts.sum() == N
    assert counts.min() > 0.7 * N / 12


def test_narrow_contexts_stay_within_40_degrees(draw):
    azimuth = draw("narrow", N)["azimuth"]
    assert np.abs(azimuth).max() <= 40
    assert azimuth.min() < -38
    assert azimuth.max() > 38


def test_fixed_contexts_are_all_the_same(task, draw):
    fields = task.model_fields(draw("fixed", 20, seed=1))
    for name in ("cam_pos", "cam_quat"):
        assert (fields[name] == fields[name][0]).all()
    visible = fields["geom_rgba"][:, :, 3] > 0
    assert (visible == visible[0]).all()
    for name in ("geom_pos", "geom_rgba"):
        shown = fields[name][:, visible[0]]
        assert (shown == shown[0]).all()
    qpos, qvel = task.context_state(draw("fixed", 20, seed=1))
    assert (qpos == qpos[0]).all()
    assert (qvel == 0).all()


@pytest.mark.parametrize("factor", FACTORS)
def test_only_the_factors_asked_for_vary(task, factor):
    only = replace(DISTRIBUTIONS["paper"], vary=frozenset({factor}))
    contexts = task.draw_contexts(np.random.default_rng(0), 50, only)
    varying = {name for names in SHOWN_BY.values() for name in names if (contexts[name] != contexts[name][0]).any()}
    assert varying == set(SHOWN_BY[factor])


def test_colours_can_be_told_from_red_and_from_each_other(draw):
    contexts = draw("paper", N)
    table, arm = contexts["table_rgb"], contexts["arm_rgb"]
    for one, other in [(table, reach.RED), (arm, reach.RED), (table, arm)]:
        assert np.linalg.norm(one - other, axis=1).min() >= 0.5
    for colours in (table, arm, contexts["distractor_rgb"]):
        assert colours.min() >= 0
        assert colours.max() <= 1


def test_distractors_can_be_told_from_red_and_from_the_table(draw):
    contexts = draw("paper", N)
    colours = contexts["distractor_rgb"]
    assert np.linalg.norm(colours - reach.RED, axis=2).min() >= 0.4
    assert np.linalg.norm(colours - contexts["table_rgb"][:, None], axis=2).min() >= 0.4


def test_goals_are_reachable(draw):
    goals = np.linalg.norm(draw("paper", N)["goal"], axis=1)
    elbows = np.stack(np.meshgrid(*[np.linspace(*reach.ELBOW_RANGE, 60)] * 2), axis=-1).reshape(-1, 2)
    qpos = np.concatenate([np.zeros((len(elbows), 1)), elbows], axis=1)
    radii = np.sort(np.linalg.norm(reach.ARM.hand(qpos), axis=1))
    within = radii[(radii > goals.min() - 0.05) & (radii < goals.max() + 0.05)]
    assert within[0] < goals.min()
    assert within[-1] > goals.max()
    assert np.diff(within).max() < 0.01  # The first joint turns freely: every radius means every direction.


def test_goals_are_away_from_where_the_hand_starts(task, draw):
    contexts = draw("paper", N)
    for qpos, _ in (task.context_state(contexts), task.draw_states(np.random.default_rng(0), contexts)):
        assert np.linalg.norm(reach.ARM.hand(qpos) - contexts["goal"], axis=1).min() > 0.3


def test_hand_position_agrees_with_the_model(task):
    from stages.simulation.batch import BatchSimulation

    qpos = np.random.default_rng(0).uniform(-0.3, 2.6, (20, 3))
    state = BatchSimulation(task, len(qpos)).reset(qpos, np.zeros_like(qpos))
    np.testing.assert_allclose(state.site_xpos[:, 0, :2], reach.ARM.hand(qpos), atol=1e-12)


def test_distractors_reach_into_the_workspace_but_not_over_the_goal(draw):
    contexts = draw("paper", N)
    positions, goals = contexts["distractor_position"], contexts["goal"]
    assert np.linalg.norm(positions, axis=2).max() < 3 * reach.LINK_LENGTH
    assert (np.linalg.norm(positions, axis=2) < 0.8).mean() > 0.3
    apart = np.linalg.norm(positions - goals[:, None], axis=2)
    assert apart.min() >= reach.GOAL_RADIUS + reach.DISTRACTOR_RADIUS
    visible = contexts["distractor_visible"]
    assert 0.45 < visible.mean() < 0.55
    assert set(visible.sum(axis=1)) == set(range(reach.N_DISTRACTORS + 1))


def test_contexts_follow_from_the_seed(draw):
    one, same, other = draw("paper", 5, 3), draw("paper", 5, 3), draw("paper", 5, 4)
    for name in one:
        assert np.array_equal(one[name], same[name])
    assert not np.array_equal(one["goal"], other["goal"])


def test_the_camera_looks_at_the_origin(draw):
    from scipy.spatial.transform import Rotation

    contexts = draw("paper", 50)
    position, quaternion = camera_pose(contexts)
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), contexts["camera_distance"])
    np.testing.assert_allclose(position[:, 2], 4 * np.sin(np.pi / 4))
    forward = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]).apply([0.0, 0.0, -1.0])
    np.testing.assert_allclose(forward, -position / 4, atol=1e-12)


def test_take_and_repeat_keep_the_leading_axis(draw):
    contexts = draw("paper", 4)
    one = take(contexts, slice(2, 3))
    assert all(len(values) == 1 for values in one.values())
    again = repeat(one, 3)
    assert all(np.array_equal(again[name], contexts[name][[2, 2, 2]]) for name in contexts)


def test_colours_keep_their_distance_from_each_of_many():
    others = np.random.default_rng(1).uniform(size=(100, 3))
    colours = draw_colours(np.random.default_rng(0), 100, others, np.zeros(3), gap=0.6)
    assert np.linalg.norm(colours - others, axis=1).min() >= 0.6
    assert np.linalg.norm(colours, axis=1).min() >= 0.6


@pytest.mark.parametrize("find", [make_task, distribution])
def test_unknown_names_are_usage_errors(find):
    with pytest.raises(UsageError, match="expected one of"):
        find("nowhere")
