"""Strike: a planar arm with four torque-driven hinges strikes a white ball toward a red target (Sec. VI).

The paper's text specifies 4 degrees of freedom and 48x48 frames, its code release 7 motors and 64x64. This task follows
the text. All targets are out of the arm's reach, so that the ball has to be struck. With the flat mallet, the ball's
direction depends more on the mallet's direction than on the point of impact. The ball stops well before the episode
ends.
"""

from __future__ import annotations

import numpy as np
from dm_control import mjcf

from stages.config.tasks import own_defaults
from stages.simulation.contexts import RED, ContextDistribution, Contexts, draw_camera, draw_table_and_arm
from stages.simulation.task import State, Task
from stages.simulation.tasks.fields import ModelFields
from stages.simulation.tasks.scene import ARM, NOTHING, Arm, add_goal, add_object, add_rim, add_table, make_scene

TABLE_HALF_SIZE = 0.95
LINK_LENGTH = 0.2  # meters
MALLET_HALF_WIDTH, MALLET_RADIUS = 0.1, 0.04
BALL_RADIUS = 0.07
BALL_MASS = 0.1  # kilograms
BALL_DAMPING = 0.25  # N s/m
BALL_RUN = BALL_MASS / BALL_DAMPING  # seconds: a ball with velocity v stops after v * BALL_RUN meters
GOAL_RADIUS = 0.1
CAMERA_DISTANCE = 2.5

STRIKER = Arm(
    (LINK_LENGTH,) * 4,
    (-0.6, 0.0),
    limits=((-2.6, 1.0), (-0.3, 2.6), (-0.3, 2.6), (-2.6, 0.6)),
    radius=0.04,
    mass=0.3,
)
NOMINAL_QPOS = np.array([-1.6, 1.6, 1.6, -1.6])  # radians
INITIAL_NOISE = 0.05  # radians, half-width of the uniform noise on the initial joint angles
BALL = np.array([0.0, 0.0])
GOAL_RANGE, GOAL_ANGLE = (0.4, 0.75), (-0.25 * np.pi, 0.25 * np.pi)  # relative to the ball: meters, radians

WHITE = np.array([1.0, 1.0, 1.0])
CANONICAL_TABLE = np.array([0.25, 0.45, 0.3])
CANONICAL_ARM = np.array([0.25, 0.25, 0.6])
CANONICAL_GOAL = np.array([0.6, 0.0])


class Strike(Task):
    """Strike with the paper's timing. Context: azimuth, target position, initial joint angles.

    The policy observes the full state: joints, ball and time. The paper weights its reward by a quadratic ramp.
    """

    name = "strike"
    defaults = own_defaults(name)
    factors = ("azimuth", "elevation", "distance", "colour", "goal", "initial")
    default_factors = ("azimuth", "goal", "initial")
    ramp = "quadratic"

    def build(self) -> mjcf.RootElement:
        root = make_scene(self.name)
        add_table(root, TABLE_HALF_SIZE, rgba=(*CANONICAL_TABLE, 1), **NOTHING)
        add_rim(root, TABLE_HALF_SIZE, (0.3, 0.2, 0.1, 1))
        add_goal(root, GOAL_RADIUS, **NOTHING)
        link = STRIKER.build(root, rgba=(*CANONICAL_ARM, 1), **ARM)
        link.add(
            "geom",
            name="mallet",
            type="capsule",
            fromto=(LINK_LENGTH, -MALLET_HALF_WIDTH, 0, LINK_LENGTH, MALLET_HALF_WIDTH, 0),
            size=(MALLET_RADIUS,),
            mass=0.1,
            rgba=(*CANONICAL_ARM, 1),
            **ARM,
        )
        link.add("site", name="hand", pos=(LINK_LENGTH, 0, 0), size=(0.01,), rgba=(0, 0, 0, 0))
        add_object(root, "ball", BALL_RADIUS, BALL_MASS, BALL_DAMPING, (*WHITE, 1), "sphere")
        return root

    def draw_contexts(self, rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
        vary = self.varied(distribution)
        contexts = draw_camera(rng, n, distribution, vary, distance=CAMERA_DISTANCE)
        canonical = (CANONICAL_TABLE, CANONICAL_ARM)
        colours = draw_table_and_arm(rng, n, canonical, RED, WHITE, varies="colour" in vary)
        radius, angle = rng.uniform(*GOAL_RANGE, n), rng.uniform(*GOAL_ANGLE, n)
        goal = BALL + np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        noise = rng.uniform(-INITIAL_NOISE, INITIAL_NOISE, (n, 4))
        return (
            contexts
            | colours
            | {
                "goal": goal if "goal" in vary else np.tile(CANONICAL_GOAL, (n, 1)),
                "initial_qpos": NOMINAL_QPOS + noise * ("initial" in vary),
            }
        )

    def model_fields(self, contexts: Contexts) -> dict[str, np.ndarray]:
        fields = ModelFields(self.model, contexts).colour(contexts["table_rgb"], "table")
        fields.colour(contexts["arm_rgb"], "link_0", "link_1", "link_2", "link_3", "mallet")
        return fields.place("goal", contexts["goal"]).done()

    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        arm = contexts["initial_qpos"]
        qpos = np.concatenate([arm, np.tile(BALL, (len(arm), 1))], axis=1)
        return qpos, np.zeros_like(qpos)

    def draw_states(self, rng: np.random.Generator, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        noise = rng.uniform(-INITIAL_NOISE, INITIAL_NOISE, contexts["initial_qpos"].shape)
        return self.context_state({"initial_qpos": NOMINAL_QPOS + noise})

    def observe(self, state: State) -> np.ndarray:
        phase = (state.time / self.horizon)[:, None]
        return np.concatenate([state.qpos, state.qvel, phase], axis=1).astype(np.float32)

    def observe_expert(self, state: State, contexts: Contexts) -> np.ndarray:
        hand, goal = state.site_xpos[:, 0, :2], contexts["goal"]
        ball, rest = state.qpos[:, 4:], _rest(state)
        return np.concatenate([self.observe(state), hand, ball - hand, goal, goal - rest], axis=1).astype(np.float32)

    def expert_reward(self, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        """Reward (n,) for a ball that will stop at the target, and for an arm that then rests."""
        miss = np.linalg.norm(_rest(state) - contexts["goal"], axis=1)
        near = np.exp(-np.square(miss / 0.1))
        effort = np.square(action).sum(axis=1)
        speed = np.square(state.qvel[:, :4]).sum(axis=1)
        hand_to_ball = np.linalg.norm(state.site_xpos[:, 0, :2] - state.qpos[:, 4:], axis=1)
        return near - 2.0 * miss - 0.1 * np.minimum(hand_to_ball, 0.3) - 0.01 * effort - 0.02 * near * speed

    def goal_error(self, state: State, contexts: Contexts) -> np.ndarray:
        """Error of the ball's stopping position from the target, and of the hand from the ball, with a small weight."""
        to_hand = state.site_xpos[:, 0, :2] - state.qpos[:, 4:]
        return np.concatenate([_rest(state) - contexts["goal"], 0.1 * to_hand], axis=1)

    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """Distance (n,) from the ball to the target's center in the table plane, meters."""
        return np.linalg.norm(state.qpos[:, 4:] - contexts["goal"], axis=1)


def _rest(state: State) -> np.ndarray:
    """Position (n, 2) where the ball would stop without obstacles, meters."""
    return state.qpos[:, 4:] + BALL_RUN * state.qvel[:, 4:]
