"""Reach: a planar arm with three torque-driven hinges moves its hand over a red disc (Sec. VI).

The paper does not show the arm. Here its base is at the center of the table, and both elbows bend to one side only,
like a person's: if they could bend either way, an expert's choice would depend on its initial noise, and a video from
another context could not predict it.
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
from stages.simulation.tasks.scene import Arm, add_distractors, add_goal, add_table, make_scene

LINK_LENGTH = 0.4  # meters
HAND_RADIUS = 0.12
TABLE_HALF_SIZE = 1.3
GOAL_RADIUS = 0.14

NOMINAL_QPOS = np.array([0.0, 0.9, 0.9])  # radians
INITIAL_NOISE = 0.1  # radians, half-width of the uniform noise on the initial joint angles
ELBOW_RANGE = (-0.3, 2.6)
ARM = Arm((LINK_LENGTH,) * 3, limits=(None, ELBOW_RANGE, ELBOW_RANGE))

GOAL_RANGE = (0.5, 1.1)  # distance from the arm's base, meters
GOAL_ANGLE = (-0.6 * np.pi, 0.9 * np.pi)  # relative to the nominal direction of the first link, radians
GOAL_CLEARANCE = 0.5  # minimum distance from the hand's nominal start, meters

CANONICAL_TABLE = np.array([0.75, 0.72, 0.65])
CANONICAL_ARM = np.array([0.2, 0.3, 0.6])
CANONICAL_GOAL = np.array([0.1, -0.9])


class Reach(Task):
    """Reach with the paper's timing: 0.01 s per physics step, 5 physics steps per control step, 50 control steps."""

    name = "reach"
    defaults = own_defaults(name)
    factors = ("azimuth", "elevation", "distance", "colour", "distractors", "goal", "initial")
    default_factors = ("azimuth", "colour", "distractors", "goal", "initial")

    def build(self) -> mjcf.RootElement:
        root = make_scene(self.name)
        root.option.flag.contact = "disable"
        add_table(root, TABLE_HALF_SIZE)
        add_distractors(root, DISTRACTOR_RADIUS)
        add_goal(root, GOAL_RADIUS)
        link = ARM.build(root)
        link.add("geom", name="hand", type="sphere", size=(HAND_RADIUS,), pos=(LINK_LENGTH, 0, 0), mass=0.1)
        link.add("site", name="hand", pos=(LINK_LENGTH, 0, 0), size=(0.01,), rgba=(0, 0, 0, 0))
        return root

    def draw_contexts(self, rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
        vary = self.varied(distribution)
        contexts = draw_camera(rng, n, distribution, vary)
        canonical = (CANONICAL_TABLE, CANONICAL_ARM)
        colours = draw_table_and_arm(rng, n, canonical, RED, varies="colour" in vary, gap=0.5)
        goal = _draw_goals(rng, n) if "goal" in vary else np.tile(CANONICAL_GOAL, (n, 1))
        noise = rng.uniform(-INITIAL_NOISE, INITIAL_NOISE, (n, 3)) if "initial" in vary else np.zeros((n, 3))
        distractors = draw_distractors(
            rng,
            goal[:, None],
            GOAL_RADIUS + DISTRACTOR_RADIUS,
            colours["table_rgb"],
            RED,
            visible="distractors" in vary,
        )
        return (
            contexts
            | colours
            | distractors
            | {
                "goal": goal,
                "initial_qpos": NOMINAL_QPOS + noise,
            }
        )

    def model_fields(self, contexts: Contexts) -> dict[str, np.ndarray]:
        fields = ModelFields(self.model, contexts).colour(contexts["table_rgb"], "table")
        fields.colour(contexts["arm_rgb"], "link_0", "link_1", "link_2", "hand").place("goal", contexts["goal"])
        return fields.distractors(contexts).done()

    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        qpos = np.array(contexts["initial_qpos"])
        return qpos, np.zeros_like(qpos)

    def draw_states(self, rng: np.random.Generator, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        qpos = NOMINAL_QPOS + rng.uniform(-INITIAL_NOISE, INITIAL_NOISE, contexts["initial_qpos"].shape)
        return qpos, np.zeros_like(qpos)

    def observe(self, state: State) -> np.ndarray:
        phase = (state.time / self.horizon)[:, None]
        return np.concatenate([state.qpos, state.qvel, phase], axis=1).astype(np.float32)

    def observe_expert(self, state: State, contexts: Contexts) -> np.ndarray:
        hand = state.site_xpos[:, 0, :2]
        parts = [self.observe(state), hand, contexts["goal"], contexts["goal"] - hand]
        return np.concatenate(parts, axis=1).astype(np.float32)

    def expert_reward(self, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        distance = self.distance(state, contexts)
        effort = np.square(action).sum(axis=1)
        speed = np.square(state.qvel).sum(axis=1)
        near = np.exp(-np.square(distance / 0.1))
        return near - distance - 0.01 * effort - 0.02 * near * speed

    def goal_error(self, state: State, contexts: Contexts) -> np.ndarray:
        """Error (n, 2) of the hand from the disc's center, meters."""
        return state.site_xpos[:, 0, :2] - contexts["goal"]

    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """Distance (n,) from the hand to the disc's center in the table plane, meters."""
        return np.linalg.norm(state.site_xpos[:, 0, :2] - contexts["goal"], axis=1)


def _draw_goals(rng: np.random.Generator, n: int) -> np.ndarray:
    """Draw goals (n, 2) within the arm's reach and away from the hand's start."""
    start = ARM.hand(NOMINAL_QPOS[None])

    def draw(m: int) -> np.ndarray:
        radius, angle = rng.uniform(*GOAL_RANGE, m), rng.uniform(*GOAL_ANGLE, m)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)

    goals = draw(n)
    while True:
        near = np.linalg.norm(goals - start, axis=1) < GOAL_CLEARANCE
        if not near.any():
            return goals
        goals[near] = draw(int(near.sum()))
