"""The household tasks: the arm, the person, and that both hold the same tool in the same picture."""

import mujoco
import numpy as np
import pytest

from stages.config.stages import HOUSEHOLD
from stages.learners.demonstrators import Person
from stages.simulation.batch import BatchSimulation, rollout
from stages.simulation.contexts import take
from stages.simulation.registry import distribution, make_task
from stages.simulation.render import RenderPool
from stages.simulation.tasks.household import SIDEWAYS
from stages.simulation.tasks.household_ladle import BOWL_DEPTH
from stages.simulation.tasks.household_push import PushReal
from stages.simulation.tasks.sawyer import JOINTS, LINKS

N = 48
LEFT = {
    "push-real": 0.1,
    "sweep-paper": 0.34,
    "sweep-almonds": 0.12,
    "ladle-almonds": 0.5,
}  # of the distance, at most, in any context


@pytest.fixture(scope="module", params=HOUSEHOLD)
def task(request):
    return make_task(request.param)


@pytest.fixture(scope="module")
def contexts(task):
    return task.draw_contexts(np.random.default_rng(0), N, distribution("paper"))


@pytest.fixture(scope="module")
def shown(task, contexts):
    """What a person who is not quite steady does in each context."""
    person = Person(task)
    act = person.begin(contexts, np.random.default_rng(1))
    return rollout(person.task, contexts, *person.task.context_state(contexts), act, 1)


def test_the_arm_has_sawyers_proportions():
    task = PushReal()
    data = mujoco.MjData(task.model)
    mujoco.mj_kinematics(task.model, data)
    at = {joint: data.xanchor[task.model.joint(joint).id] for joint in JOINTS}
    axes = {joint: data.xaxis[task.model.joint(joint).id] for joint in JOINTS}

    def along(first, second, axis):
        return abs((at[second] - at[first]) @ axes[axis])

    assert np.linalg.norm(at["right_j1"] - at["right_j0"]) == pytest.approx(np.linalg.norm((0.081, 0.05, 0.237)))
    assert along("right_j1", "right_j3", "right_j2") == pytest.approx(0.4)  # the upper arm
    assert along("right_j3", "right_j5", "right_j4") == pytest.approx(0.4)  # the forearm
    for link, joint in zip(LINKS, JOINTS, strict=True):
        assert tuple(task.model.joint(joint).range) == link.limits


def test_an_action_of_one_brings_a_joint_to_95_percent_of_its_published_speed():
    task = PushReal()
    data = mujoco.MjData(task.model)
    index = JOINTS.index("right_j6")
    data.qpos[: task.driven] = task.initial
    data.ctrl[index] = 1.0
    for _ in range(200):
        mujoco.mj_step(task.model, data)
        data.qpos[: task.driven] = task.initial  # Held where it is: limits do not stop it.
    assert data.qvel[index] == pytest.approx(0.95 * LINKS[index].speed, rel=0.02)


def test_people_do_what_they_show(task, shown):
    assert shown.normalised_distance.max() <= LEFT[task.name]
    assert shown.normalised_distance.mean() < 0.06


def test_people_are_not_quite_steady(task, contexts):
    person = Person(task).task
    steady, one, other = (person.plan(contexts, rng) for rng in (None, *map(np.random.default_rng, (1, 2))))
    assert np.array_equal(steady, person.plan(contexts))
    assert np.array_equal(one, person.plan(contexts, np.random.default_rng(1)))
    apart = [np.abs(path - steady).max(axis=(0, 2)) for path in (one, other)]
    assert all((noise > 0).all() and noise.mean() < 0.25 for noise in apart)
    assert (one != other).any(axis=(0, 2)).all()
    assert np.abs(one).max() <= 1  # Hands reach as far as they mean to.


def test_things_stand_still_until_they_are_touched(task, contexts):
    simulation = BatchSimulation(task, N, 1)
    before = simulation.reset(*task.context_state(contexts)).qpos
    for _ in range(5):
        after = simulation.step(np.zeros((N, task.action_size))).qpos
    moved = 5e-3 if task.name == "ladle-almonds" else 1e-4  # Metres: the ladle itself gives way, almonds settle.
    assert np.allclose(before[:, task.driven :], after[:, task.driven :], atol=moved)
    assert np.allclose(before, after, atol=0.01)  # The table pushes at a tool that begins too low.


@pytest.mark.gl
def test_robot_and_person_look_the_same(task, contexts):
    """In all frames: neither arm nor hand is ever in the picture, and both hold the tool alike."""
    person = task.demonstrator
    with RenderPool.of(task, 1) as robots, RenderPool.of(person, 1) as people:
        for k in range(4):
            one = take(contexts, slice(k, k + 1))
            led, shown = task.kinesthetic(one), np.zeros((task.frames, person.model.nq))
            shown[:, : person.driven] = person.path(one)[: task.control_steps : task.frame_every, 0]
            led[:, task.driven :] = shown[:, person.driven :] = person.context_state(one)[0][0, person.driven :]
            robot = robots.render(task.model_fields(one), led[None])[0].astype(int)
            hand = people.render(person.model_fields(one), shown[None])[0].astype(int)
            assert (np.abs(robot - hand).max(axis=-1) > 40).mean(axis=(1, 2)).max() < 0.005
            assert robot.std(axis=(1, 2)).min(axis=0).max() > 10


def test_a_led_arm_brings_the_tool_where_the_person_does(task, contexts):
    for k in (0, 1, 2):
        one = take(contexts, slice(k, k + 1))
        qpos = task.kinesthetic(one)
        poses = task.demonstrator.path(one)[: task.control_steps : task.frame_every, 0]
        data = mujoco.MjData(task.model)
        for posture, pose in zip(qpos, poses, strict=True):
            data.qpos[:] = posture
            mujoco.mj_kinematics(task.model, data)
            assert np.allclose(data.site("tip").xpos, pose[:3], atol=2e-3)
            ahead = data.site("front").xpos - data.site("tip").xpos
            assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(pose[3], abs=0.02)
        limits = task.model.jnt_range[: task.driven]
        assert (qpos[:, : task.driven] >= limits[:, 0]).all() and (qpos[:, : task.driven] <= limits[:, 1]).all()
        assert np.abs(np.diff(qpos[:, : task.driven], axis=0)).max() < 0.4  # It does not turn over on the way.


def test_pictures_are_taken_from_the_front_and_differ(task):
    for name, half in (("paper", SIDEWAYS), ("narrow", 40.0), ("fixed", 0.0)):
        contexts = task.draw_contexts(np.random.default_rng(0), 500, distribution(name))
        away = np.abs(contexts["azimuth"] - task.filmed_from[0])
        assert away.max() == pytest.approx(half, abs=1)
        for field in ("table_rgb", "table_texture", "arm_noise"):
            assert (contexts[field] != contexts[field][0]).any() == (name != "fixed")
    contexts = task.draw_contexts(np.random.default_rng(0), 500, distribution("paper"))
    for colour in task.keep_clear():
        assert np.linalg.norm(contexts["table_rgb"] - colour, axis=1).min() >= 0.5


def test_fractions_count_what_lies_in_the_pan():
    task = make_task("sweep-almonds")
    contexts = task.draw_contexts(np.random.default_rng(0), 2, distribution("paper"))
    qpos, qvel = task.context_state(contexts)
    pieces = qpos[:, task.driven :].reshape(2, task.pieces, 2)
    pieces[0, :9] = (0.2, 0.0)
    pieces[1] = (0.2, 0.0)
    pieces[1, 0] = (0.105, 0.0)  # It has not passed the open side whole.
    qpos[:, task.driven :] = pieces.reshape(2, -1)
    state = BatchSimulation(task, 2, 1).reset(qpos, qvel)
    assert task.distance(state, contexts) == pytest.approx([0.5, 1 / task.pieces])
    left = np.square(task.goal_error(state, contexts)[:, : 2 * task.pieces]).reshape(2, task.pieces, 2).sum(axis=2)
    assert np.flatnonzero(left[0]).tolist() == list(range(9, task.pieces))
    assert np.flatnonzero(left[1]).tolist() == [0]


@pytest.mark.parametrize(("degrees", "falls"), [(-60, False), (60, False), (100, True), (150, True)])
def test_almonds_stay_in_the_ladle_until_it_is_turned_and_fall_where_it_is(degrees, falls):
    task = make_task("ladle-almonds")
    contexts = task.draw_contexts(np.random.default_rng(0), 4, distribution("paper"))
    hand = task.demonstrator
    turned = hand.demonstrated(np.array([*hand.start[:4], np.radians(degrees)]))
    simulation = BatchSimulation(hand, 4, 1)
    state = simulation.reset(*hand.context_state(contexts))
    lying = state.qpos[:, hand.driven + 4 :: 3]
    assert (lying > hand.start[2]).all()  # They begin in the ladle.
    for _ in range(hand.control_steps):
        state = simulation.step(np.tile(turned, (4, 1)))
    fallen = state.qpos[:, hand.driven + 4 :: 3]
    if not falls:
        assert (fallen > hand.start[2] - BOWL_DEPTH).all()
        return
    assert (fallen < 0.02).all() and (fallen > 0).all()  # On the table, and not through it.
    assert (hand.distance(state, contexts) == 1).all()
