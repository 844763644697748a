"""Sweep: a planar arm with long links sweeps five gray balls into a dustpan (Sec. VI).

The last link is the broom: the arm starts behind the balls and pulls the broom across the table to the pan. The balls
slide in the table plane and stop soon. They cannot pass the three walls of the pan or the four walls of the table.
"""

from __future__ import annotations

import numpy as np
from dm_control import mjcf

from stages.config.tasks import own_defaults
from stages.simulation.contexts import ContextDistribution, Contexts, draw_camera, draw_table_and_arm
from stages.simulation.task import State, Task
from stages.simulation.tasks.fields import ModelFields
from stages.simulation.tasks.scene import ARM, NOTHING, Arm, add_object, add_rim, add_table, add_wall, make_scene

TABLE_HALF_SIZE = 1.4
N_BALLS = 5
BALL_RADIUS = 0.09
BALL_MASS = 0.05  # kilograms
BALL_DAMPING = 0.5  # N s/m: a ball stops within about 0.1 s

BASE = (-1.05, 0.0)
SWEEPER = Arm((0.8, 0.8, 0.8), BASE, limits=((-0.6, 2.4), (-2.6, 0.3), (-1.5, 2.0)), radius=0.07, mass=0.3)
NOMINAL_QPOS = np.array([1.54, -1.79, 0.25])  # radians
INITIAL_NOISE = 0.05  # radians, half-width of the uniform noise on the initial joint angles
BALLS = np.array([[-0.12, 0.2], [0.14, 0.2], [0.4, 0.2], [0.0, -0.05], [0.26, -0.05]])
BALL_NOISE = 0.02  # meters, half-width of the uniform noise on the balls' initial positions

PAN_LOW, PAN_HIGH = np.array([0.35, -0.95]), np.array([1.0, -0.4])  # interior corners, meters; open at high y
PAN_WALL = 0.03  # half of a wall's thickness, meters
PAN_HEIGHT = 0.12

GREY = np.array([0.72, 0.72, 0.74])
CANONICAL_TABLE = np.array([0.62, 0.44, 0.26])
CANONICAL_ARM = np.array([0.2, 0.3, 0.6])
PAN = np.array([0.85, 0.75, 0.2])


class Sweep(Task):
    """Sweep with the paper's timing and frames of 36x64. Context: azimuth, and small noise on the initial state.

    The policy observes the full state: joints, balls and time. A run succeeds below 0.55 of the initial distance.
    """

    name = "sweep"
    defaults = own_defaults(name)
    factors = ("azimuth", "elevation", "distance", "colour", "initial")
    default_factors = ("azimuth", "initial")
    frame_size = (36, 64)
    success_threshold = 0.55

    def build(self) -> mjcf.RootElement:
        root = make_scene(self.name)
        add_table(root, TABLE_HALF_SIZE, rgba=(*CANONICAL_TABLE, 1), **NOTHING)
        add_rim(root, TABLE_HALF_SIZE, (0.3, 0.2, 0.1, 1))
        middle, half = (PAN_LOW + PAN_HIGH) / 2, (PAN_HIGH - PAN_LOW) / 2
        root.worldbody.add(
            "geom", name="pan", type="box", size=(*half, 0.005), pos=(*middle, 0.006), rgba=(*PAN, 1), **NOTHING
        )
        wide = half[0] + 2 * PAN_WALL
        for name, centre, size in (
            ("pan_left", (PAN_LOW[0] - PAN_WALL, middle[1]), (PAN_WALL, half[1])),
            ("pan_right", (PAN_HIGH[0] + PAN_WALL, middle[1]), (PAN_WALL, half[1])),
            ("pan_back", (middle[0], PAN_LOW[1] - PAN_WALL), (wide, PAN_WALL)),
        ):
            add_wall(root, name, centre, size, PAN_HEIGHT, (*PAN, 1))
        link = SWEEPER.build(root, rgba=(*CANONICAL_ARM, 1), **ARM)
        link.add("site", name="hand", pos=(SWEEPER.lengths[-1], 0, 0), size=(0.01,), rgba=(0, 0, 0, 0))
        for k in range(N_BALLS):
            add_object(root, f"ball_{k}", BALL_RADIUS, BALL_MASS, BALL_DAMPING, (*GREY, 1), "sphere")
        return root

    def draw_contexts(self, rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
        vary = self.varied(distribution)
        contexts = draw_camera(rng, n, distribution, vary)
        canonical = (CANONICAL_TABLE, CANONICAL_ARM)
        colours = draw_table_and_arm(rng, n, canonical, PAN, GREY, varies="colour" in vary)
        scale = float("initial" in vary)
        noise = scale * rng.uniform(-INITIAL_NOISE, INITIAL_NOISE, (n, 3))
        balls = BALLS + scale * rng.uniform(-BALL_NOISE, BALL_NOISE, (n, N_BALLS, 2))
        return (
            contexts
            | colours
            | {
                "balls": balls,
                "initial_qpos": NOMINAL_QPOS + noise,
            }
        )

    def model_fields(self, contexts: Contexts) -> dict[str, np.ndarray]:
        fields = ModelFields(self.model, contexts).colour(contexts["table_rgb"], "table")
        return fields.colour(contexts["arm_rgb"], "link_0", "link_1", "link_2").done()

    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        qpos = np.concatenate([contexts["initial_qpos"], contexts["balls"].reshape(-1, 2 * N_BALLS)], axis=1)
        return qpos, np.zeros_like(qpos)

    def draw_states(self, rng: np.random.Generator, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        noise = rng.uniform(-INITIAL_NOISE, INITIAL_NOISE, contexts["initial_qpos"].shape)
        return self.context_state(contexts | {"initial_qpos": NOMINAL_QPOS + noise})

    def observe(self, state: State) -> np.ndarray:
        phase = (state.time / self.horizon)[:, None]
        return np.concatenate([state.qpos, state.qvel, phase], axis=1).astype(np.float32)

    def observe_expert(self, state: State, contexts: Contexts) -> np.ndarray:
        return np.concatenate([self.observe(state), state.site_xpos[:, 0, :2]], axis=1).astype(np.float32)

    def expert_reward(self, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        """Reward (n,) for balls in or near the pan, and for an arm that then rests."""
        away = _outside(_balls(state))
        inside = (away < 0.01).mean(axis=1)
        effort = np.square(action).sum(axis=1)
        speed = np.square(state.qvel[:, :3]).sum(axis=1)
        return inside - 2.0 * away.mean(axis=1) - 0.01 * effort - 0.02 * inside * speed

    def goal_error(self, state: State, contexts: Contexts) -> np.ndarray:
        """Error of each ball from the interior of the pan; zero inside."""
        return _apart(_balls(state)).reshape(len(state.qpos), -1)

    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """Distance (n,) to the interior of the pan in the table plane, averaged over the balls, meters; zero inside."""
        return _outside(_balls(state)).mean(axis=1)


def _balls(state: State) -> np.ndarray:
    """Positions of the balls (n, 5, 2), meters."""
    return state.qpos[:, 3:].reshape(-1, N_BALLS, 2)


def _outside(points: np.ndarray) -> np.ndarray:
    """Distance of points (..., 2) to the interior of the pan, where a ball has passed the open side completely."""
    return np.linalg.norm(_apart(points), axis=-1)


def _apart(points: np.ndarray) -> np.ndarray:
    """Offset (..., 2) of points from the nearest point in the interior of the pan."""
    high = PAN_HIGH - np.array([0.0, BALL_RADIUS])
    return points - np.clip(points, PAN_LOW, high)
