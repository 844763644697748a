"""Push: a planar arm with three torque-driven hinges pushes a white cylinder onto a red coaster (Sec. VI).

The paper does not show the hand. Here it is a fork that holds the cylinder: a round, frictionless hand would let the
cylinder slip off to either side, and a policy that observes only its own joints could not tell to which. Positions are
drawn so that the hand can reach behind the cylinder, point at the coaster, and push the cylinder there.
"""

from __future__ import annotations

import numpy as np
from dm_control import mjcf

from stages.config.tasks import own_defaults
from stages.simulation.contexts import (
    DISTRACTOR_RADIUS,
    RED,
    ContextDistribution,
    Contexts,
    draw_camera,
    draw_distractors,
    draw_table_and_arm,
)
from stages.simulation.task import State, Task
from stages.simulation.tasks.fields import ModelFields
from stages.simulation.tasks.scene import (
    ARM,
    NOTHING,
    Arm,
    add_distractors,
    add_goal,
    add_object,
    add_rim,
    add_table,
    make_scene,
)

LINK_LENGTH = 0.4  # meters
FORK_LENGTH, FORK_HALF_WIDTH, FORK_RADIUS = 0.12, 0.14, 0.045
TABLE_HALF_SIZE = 1.3
CYLINDER_RADIUS = 0.12
CYLINDER_MASS = 0.3  # kilograms
CYLINDER_DAMPING = 5.0  # N s/m: the cylinder stops within 0.06 s
GOAL_RADIUS = 0.15
HAND_TO_CYLINDER = 0.22  # from the end of the last link to the center of a cylinder in the fork, meters
APPROACH = 0.12  # additional distance before the fork touches the cylinder, meters

ELBOW_RANGE, WRIST_RANGE = (-0.3, 2.6), (-2.0, 2.0)
PUSHER = Arm((LINK_LENGTH,) * 3, limits=(None, ELBOW_RANGE, WRIST_RANGE))
NOMINAL_QPOS = np.array([-2.0, 1.4, 0.2])  # radians
INITIAL_NOISE = 0.1  # radians, half-width of the uniform noise on the initial joint angles

CYLINDER_RANGE, CYLINDER_ANGLE = (0.5, 0.9), (-0.3 * np.pi, 0.5 * np.pi)
GOAL_RANGE, GOAL_ANGLE = (0.45, 1.1), (-0.3 * np.pi, 0.7 * np.pi)
LEAST_PUSH = 0.45  # minimum distance from cylinder to goal, meters
START_CLEARANCE = 0.03  # minimum distance between cylinder and arm at the start, meters
BASE_CLEARANCE = 0.35  # minimum distance between the cylinder's path and the arm's base, meters

WHITE = np.array([1.0, 1.0, 1.0])
CANONICAL_TABLE = np.array([0.45, 0.4, 0.35])
CANONICAL_ARM = np.array([0.2, 0.3, 0.6])
CANONICAL_CYLINDER = np.array([0.7, 0.2])
CANONICAL_GOAL = np.array([0.45, 0.85])


class Push(Task):
    """Push with the paper's timing: 0.01 s per physics step, 5 physics steps per control step, 50 control steps.

    Context: azimuth, distractors, positions of cylinder and goal, initial joint angles; colors on request. As in the
    paper, the policy observes its joints and the time, never the cylinder.
    """

    name = "push"
    defaults = own_defaults(name)
    factors = ("azimuth", "elevation", "distance", "colour", "distractors", "goal", "initial")
    default_factors = ("azimuth", "distractors", "goal", "initial")

    def build(self) -> mjcf.RootElement:
        root = make_scene(self.name)
        add_table(root, TABLE_HALF_SIZE, rgba=(*CANONICAL_TABLE, 1), **NOTHING)
        add_rim(root, TABLE_HALF_SIZE, (0.3, 0.27, 0.24, 1))
        add_distractors(root, DISTRACTOR_RADIUS, **NOTHING)
        add_goal(root, GOAL_RADIUS, **NOTHING)
        link = PUSHER.build(root, rgba=(*CANONICAL_ARM, 1), **ARM)
        for side, name in ((1, "finger_left"), (-1, "finger_right")):
            link.add(
                "geom",
                name=name,
                type="capsule",
                fromto=(LINK_LENGTH, 0, 0, LINK_LENGTH + FORK_LENGTH, side * FORK_HALF_WIDTH, 0),
                size=(FORK_RADIUS,),
                mass=0.05,
                rgba=(*CANONICAL_ARM, 1),
                **ARM,
            )
        link.add("site", name="hand", pos=(LINK_LENGTH, 0, 0), size=(0.01,), rgba=(0, 0, 0, 0))
        add_object(root, "cylinder", CYLINDER_RADIUS, CYLINDER_MASS, CYLINDER_DAMPING, (*WHITE, 1), "cylinder")
        return root

    def draw_contexts(self, rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
        vary = self.varied(distribution)
        contexts = draw_camera(rng, n, distribution, vary)
        canonical = (CANONICAL_TABLE, CANONICAL_ARM)
        colours = draw_table_and_arm(rng, n, canonical, RED, WHITE, varies="colour" in vary)
        if "goal" in vary:
            cylinder, goal = _draw_places(rng, n)
        else:
            cylinder, goal = np.tile(CANONICAL_CYLINDER, (n, 1)), np.tile(CANONICAL_GOAL, (n, 1))
        noise = rng.uniform(-INITIAL_NOISE, INITIAL_NOISE, (n, 3)) if "initial" in vary else np.zeros((n, 3))
        clearance = GOAL_RADIUS + DISTRACTOR_RADIUS
        clear_of = np.stack([goal, cylinder], axis=1)
        distractors = draw_distractors(
            rng, clear_of, clearance, colours["table_rgb"], RED, WHITE, visible="distractors" in vary
        )
        return (
            contexts
            | colours
            | distractors
            | {
                "goal": goal,
                "cylinder": cylinder,
                "initial_qpos": NOMINAL_QPOS + noise,
            }
        )

    def model_fields(self, contexts: Contexts) -> dict[str, np.ndarray]:
        fields = ModelFields(self.model, contexts).colour(contexts["table_rgb"], "table")
        fields.colour(contexts["arm_rgb"], "link_0", "link_1", "link_2", "finger_left", "finger_right")
        return fields.place("goal", contexts["goal"]).distractors(contexts).done()

    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        qpos = np.concatenate([contexts["initial_qpos"], contexts["cylinder"]], axis=1)
        return qpos, np.zeros_like(qpos)

    def draw_states(self, rng: np.random.Generator, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        noise = rng.uniform(-INITIAL_NOISE, INITIAL_NOISE, contexts["initial_qpos"].shape)
        qpos = np.concatenate([NOMINAL_QPOS + noise, contexts["cylinder"]], axis=1)
        return qpos, np.zeros_like(qpos)

    def observe(self, state: State) -> np.ndarray:
        phase = (state.time / self.horizon)[:, None]
        return np.concatenate([state.qpos[:, :3], state.qvel[:, :3], phase], axis=1).astype(np.float32)

    def observe_expert(self, state: State, contexts: Contexts) -> np.ndarray:
        hand, cylinder, goal = state.site_xpos[:, 0, :2], state.qpos[:, 3:], contexts["goal"]
        behind = _behind(cylinder, goal)
        parts = [self.observe(state), hand, cylinder, state.qvel[:, 3:], goal, cylinder - hand, goal - cylinder, behind]
        return np.concatenate([*parts, behind - hand], axis=1).astype(np.float32)

    def expert_reward(self, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        """Reward (n,) for the hand being behind the cylinder, in line with the goal, and the cylinder at the goal."""
        hand, cylinder, goal = state.site_xpos[:, 0, :2], state.qpos[:, 3:], contexts["goal"]
        distance = self.distance(state, contexts)
        away = np.linalg.norm(_behind(cylinder, goal) - hand, axis=1)
        near = np.exp(-np.square(distance / 0.1))
        effort = np.square(action).sum(axis=1)
        speed = np.square(state.qvel[:, :3]).sum(axis=1)
        return near - 2.0 * distance - 0.5 * away - 0.01 * effort - 0.02 * near * speed

    def goal_error(self, state: State, contexts: Contexts) -> np.ndarray:
        """Error of the cylinder from the goal, and of the hand from its pushing position, with weight one quarter."""
        hand, cylinder, goal = state.site_xpos[:, 0, :2], state.qpos[:, 3:], contexts["goal"]
        return np.concatenate([cylinder - goal, 0.5 * (hand - _behind(cylinder, goal))], axis=1)

    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """Distance (n,) from the cylinder to the goal in the table plane, meters."""
        return np.linalg.norm(state.qpos[:, 3:] - contexts["goal"], axis=1)


def _behind(cylinder: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Position (n, 2) of the hand from which it pushes the cylinder (n, 2) to the goal (n, 2)."""
    way = goal - cylinder
    return cylinder - HAND_TO_CYLINDER * way / (np.linalg.norm(way, axis=1, keepdims=True) + 0.05)


def _can_point(hand: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Whether the end of the last link can reach `hand` (n, 2), pointing along the unit vector `direction`."""
    wrist = hand - LINK_LENGTH * direction
    away = np.linalg.norm(wrist, axis=1)
    elbow = 2 * np.arccos(np.clip(away / (2 * LINK_LENGTH), 0, 1))
    shoulder = np.arctan2(wrist[:, 1], wrist[:, 0]) - elbow / 2
    bend = np.arctan2(direction[:, 1], direction[:, 0]) - shoulder - elbow
    bend = (bend + np.pi) % (2 * np.pi) - np.pi
    return (away < 1.95 * LINK_LENGTH) & (elbow < ELBOW_RANGE[1] - 0.1) & (np.abs(bend) < WRIST_RANGE[1] - 0.1)


def _starting_arm() -> np.ndarray:
    """Points (m, 2) along the links and fingers for the extremes of the initial noise."""
    corners = np.stack(np.meshgrid(*[(-INITIAL_NOISE, 0.0, INITIAL_NOISE)] * 3), axis=-1).reshape(-1, 3)
    angles = np.cumsum(NOMINAL_QPOS + corners, axis=1)
    directions = LINK_LENGTH * np.stack([np.cos(angles), np.sin(angles)], axis=2)
    ends = np.cumsum(directions, axis=1)
    along = np.linspace(0.0, 1.0, 9)[:, None]
    points = [ends[:, k, None] - along * directions[:, k, None] for k in range(3)]
    for side in (1, -1):
        bend = angles[:, 2] + side * np.arctan2(FORK_HALF_WIDTH, FORK_LENGTH)
        finger = np.hypot(FORK_LENGTH, FORK_HALF_WIDTH) * np.stack([np.cos(bend), np.sin(bend)], axis=1)
        points.append(ends[:, 2, None] + along * finger[:, None])
    return np.concatenate([each.reshape(-1, 2) for each in points])


def _draw_places(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw positions (n, 2) of cylinders and goals so that each cylinder can be pushed to its goal."""
    from scipy.spatial import cKDTree

    def draw(m: int, radii: tuple[float, float], angles: tuple[float, float]) -> np.ndarray:
        radius, angle = rng.uniform(*radii, m), rng.uniform(*angles, m)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)

    cylinder, goal = np.empty((n, 2)), np.empty((n, 2))
    arm = cKDTree(_starting_arm())
    wrong = np.ones(n, bool)
    while wrong.any():
        m = int(wrong.sum())
        cylinder[wrong], goal[wrong] = draw(m, CYLINDER_RANGE, CYLINDER_ANGLE), draw(m, GOAL_RANGE, GOAL_ANGLE)
        way = goal - cylinder
        length = np.linalg.norm(way, axis=1, keepdims=True)
        direction = way / length
        along = np.clip(-(cylinder * direction).sum(axis=1, keepdims=True), 0, length)
        wrong = (length[:, 0] < LEAST_PUSH) | (np.linalg.norm(cylinder + along * direction, axis=1) < BASE_CLEARANCE)
        wrong |= ~_can_point(cylinder - (HAND_TO_CYLINDER + APPROACH) * direction, direction)
        wrong |= ~_can_point(goal - HAND_TO_CYLINDER * direction, direction)
        wrong |= arm.query(cylinder)[0] < CYLINDER_RADIUS + PUSHER.radius + START_CLEARANCE
    return cylinder, goal
