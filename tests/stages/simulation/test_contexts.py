"""What contexts vary in, in every task."""

from __future__ import annotations

import numpy as np
import pytest

from artifacts import UsageError
from stages.config.stages import TASKS
from stages.simulation.contexts import DISTRIBUTIONS, FACTORS, RED, camera_pose, draw_colours, repeat, take
from stages.simulation.registry import distribution, make_task
from stages.simulation.tasks.push import WHITE
from stages.simulation.tasks.sweep import GREY

N = 2000
SHOWN_BY = {
    "azimuth": {"azimuth"},
    "elevation": {"elevation"},
    "distance": {"camera_distance"},
    "colour": {"table_rgb", "arm_rgb"},
    "distractors": {"distractor_visible"},
    "goal": {"goal", "cylinder"},
    "initial": {"initial_qpos", "balls"},
}
# What table and arm must not be taken for.
OBJECT_COLOURS = {"reach": [RED], "push": [RED, WHITE], "sweep": [GREY], "strike": [RED, WHITE]}
HIDDEN = ("distractor_position", "distractor_rgb")  # drawn whether there are distractors or not


@pytest.fixture(scope="session", params=TASKS)
def task(request):
    """The paper's four; what varies in the household's is in test_household.py."""
    return make_task(request.param)


def varying(contexts) -> set[str]:
    """Names of what differs between contexts."""
    return {name for name, values in contexts.items() if name not in HIDDEN and (values != values[0]).any()}


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
    contexts = draw("fixed", 20, seed=1)
    fields = task.model_fields(contexts)
    for name in ("cam_pos", "cam_quat"):
        assert (fields[name] == fields[name][0]).all()
    visible = fields["geom_rgba"][:, :, 3] > 0
    assert (visible == visible[0]).all()
    for name in ("geom_pos", "geom_rgba"):
        shown = fields[name][:, visible[0]]
        assert (shown == shown[0]).all()
    qpos, qvel = task.context_state(contexts)
    assert (qpos == qpos[0]).all()
    assert (qvel == 0).all()


def test_only_the_factors_asked_for_vary(task, draw):
    for factor in task.factors:
        contexts = draw("paper", 50, vary=factor)
        assert varying(contexts) == SHOWN_BY[factor] & set(contexts)


def test_by_default_what_the_paper_varies_varies(task, draw):
    contexts = draw("paper", 50)
    expected = set().union(*(SHOWN_BY[factor] for factor in task.default_factors))
    assert varying(contexts) == expected & set(contexts)


def test_a_factor_that_the_task_lacks_is_a_usage_error(task, draw):
    for factor in set(FACTORS) - set(task.factors):
        with pytest.raises(UsageError, match=f"--vary {factor}: expected factors of {task.name}: "):
            draw("paper", vary=factor)


def test_what_a_camera_shows_does_not_hang_on_what_else_varies(draw):
    alone, both = draw("paper", 20, vary="azimuth"), draw("paper", 20, vary="azimuth,elevation,distance")
    assert np.array_equal(alone["azimuth"], both["azimuth"])


def test_elevation_and_distance_vary_within_their_ranges(draw):
    contexts, own = draw("paper", N, vary="elevation,distance"), draw("fixed")
    ranges = DISTRIBUTIONS["paper"]
    for drawn, (low, high) in [
        (contexts["elevation"], ranges.elevation),
        (contexts["camera_distance"] / own["camera_distance"], ranges.distance),
    ]:
        slack = 0.02 * (high - low)
        assert low <= drawn.min() < low + slack
        assert high - slack < drawn.max() <= high


def test_colours_can_be_told_from_the_objects_and_from_each_other(task, draw):
    contexts = draw("paper", N, vary="colour")
    table, arm = contexts["table_rgb"], contexts["arm_rgb"]
    for colours in (table, arm):
        assert colours.min() >= 0
        assert colours.max() <= 1
        for other in OBJECT_COLOURS[task.name]:
            assert np.linalg.norm(colours - other, axis=1).min() >= 0.4
    assert np.linalg.norm(table - arm, axis=1).min() >= 0.4


@pytest.mark.parametrize("task", ["reach", "push"], indirect=True)
def test_distractors_can_be_told_from_red_and_from_the_table(draw):
    contexts = draw("paper", N)
    colours = contexts["distractor_rgb"]
    assert np.linalg.norm(colours - RED, axis=2).min() >= 0.4
    assert np.linalg.norm(colours - contexts["table_rgb"][:, None], axis=2).min() >= 0.4


@pytest.mark.parametrize("task", ["reach", "push"], indirect=True)
def test_each_distractor_is_there_half_of_the_time(draw):
    visible = draw("paper", N)["distractor_visible"]
    assert 0.45 < visible.mean() < 0.55
    assert set(visible.sum(axis=1)) == set(range(visible.shape[1] + 1))


def test_contexts_follow_from_the_seed(draw):
    one, same, other = draw("paper", 5, 3), draw("paper", 5, 3), draw("paper", 5, 4)
    for name in one:
        assert np.array_equal(one[name], same[name])
    for name in varying(one):
        assert not np.array_equal(one[name], other[name])


def test_the_camera_looks_at_the_origin(draw):
    from scipy.spatial.transform import Rotation

    contexts = draw("paper", 50, vary="azimuth,elevation,distance")
    position, quaternion = camera_pose(contexts)
    distance = contexts["camera_distance"]
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), distance)
    np.testing.assert_allclose(position[:, 2], -distance * np.sin(np.radians(contexts["elevation"])))
    forward = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]).apply([0.0, 0.0, -1.0])
    np.testing.assert_allclose(forward, -position / distance[:, None], atol=1e-12)


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
