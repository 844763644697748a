"""push-real: push a can onto a coaster with a fork on a rod, as demonstrated by a person (Sec. VI.D.1)."""

from __future__ import annotations

import numpy as np
from dm_control import mjcf

from stages.config.tasks import own_defaults
from stages.simulation.contexts import Contexts
from stages.simulation.task import State
from stages.simulation.tasks.fields import ModelFields
from stages.simulation.tasks.household import YELLOW, Household, add_piece, plate
from stages.simulation.tasks.scene import NOTHING

CAN_RADIUS, CAN_HEIGHT = 0.04, 0.1  # meters
CAN_MASS, CAN_DAMPING = 0.2, 5.0  # kilograms, N s/m
COASTER_RADIUS = 0.06
FORK_ANGLE, FORK_LENGTH = np.radians(55), 0.07  # of each side
TIP_TO_CAN = 0.057  # from the tool's tip to the center of a can in the fork, meters
APPROACH = 0.06  # additional distance before the fork touches the can, meters

CAN = (np.array([-0.13, -0.1]), np.array([0.0, 0.1]))  # corners of the range of initial positions, meters
COASTER = (np.array([0.06, -0.2]), np.array([0.2, 0.2]))
WAY = (0.16, 0.3)  # range of the distance from can to coaster, meters
WAY_ANGLE = np.radians(45)  # maximum deviation from straight ahead
CANONICAL_CAN, CANONICAL_COASTER = np.array([-0.06, 0.0]), np.array([0.14, 0.05])
WHITE, RED = np.array([0.95, 0.95, 0.95]), np.array([0.9, 0.1, 0.1])


class PushReal(Household):
    """Push-real. Context: azimuth, table, can and coaster, small noise on the arm's initial pose.

    A run succeeds if the final distance is below a quarter of the initial distance, about five centimeters.
    """

    name = "push-real"
    defaults = own_defaults(name)
    success_threshold = 0.25
    ramp = "quadratic"
    start = (-0.26, 0.0, 0.025, 0.0, 0.0)

    def add_tool(self, body: mjcf.Element) -> None:
        for side, name in ((1, "fork_left"), (-1, "fork_right")):
            half = FORK_LENGTH / 2
            at = (half * np.cos(FORK_ANGLE), side * half * np.sin(FORK_ANGLE))
            plate(body, name, at, (0.006, half), side * (FORK_ANGLE - np.pi / 2))

    def add_objects(self, root: mjcf.RootElement) -> None:
        root.worldbody.add(
            "geom",
            name="goal",
            type="cylinder",
            size=(COASTER_RADIUS, 0.003),
            pos=(0, 0, 0.003),
            rgba=(*RED, 1),
            **NOTHING,
        )
        add_piece(root, "can", CAN_RADIUS, CAN_HEIGHT, CAN_MASS, CAN_DAMPING, (*WHITE, 1), "cylinder")

    def keep_clear(self) -> tuple[np.ndarray, ...]:
        return WHITE, RED, np.array(YELLOW[:3])

    def draw_objects(self, rng: np.random.Generator, n: int, vary: bool) -> Contexts:
        can, coaster = np.tile(CANONICAL_CAN, (n, 1)), np.tile(CANONICAL_COASTER, (n, 1))
        wrong = np.full(n, vary)
        while wrong.any():
            m = int(wrong.sum())
            can[wrong], coaster[wrong] = rng.uniform(*CAN, (m, 2)), rng.uniform(*COASTER, (m, 2))
            way = coaster - can
            length = np.linalg.norm(way, axis=1)
            wrong = (length < WAY[0]) | (length > WAY[1]) | (np.abs(np.arctan2(way[:, 1], way[:, 0])) > WAY_ANGLE)
        return {"can": can, "goal": coaster}

    def place(self, fields: ModelFields, contexts: Contexts) -> ModelFields:
        return fields.place("goal", contexts["goal"])

    def objects(self, contexts: Contexts) -> np.ndarray:
        return contexts["can"]

    def waypoints(self, contexts: Contexts) -> list[tuple[float, np.ndarray]]:
        way = contexts["goal"] - contexts["can"]
        yaw = np.arctan2(way[:, 1], way[:, 0])
        ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)

        def pose(tip: np.ndarray) -> np.ndarray:
            height = np.full(len(tip), self.start[2])
            return np.stack([tip[:, 0], tip[:, 1], height, yaw, np.zeros(len(tip))], axis=1)

        behind = contexts["can"] - (TIP_TO_CAN + APPROACH) * ahead
        return [(0.35, pose(behind)), (0.85, pose(contexts["goal"] - TIP_TO_CAN * ahead))]

    def goal_error(self, state: State, contexts: Contexts) -> np.ndarray:
        """Error of the can from the goal, and (with weight 1/4) of the fork's tip and front from the pushing pose.

        The height of the tool has full weight: above the can, it moves nothing.
        """
        can, goal = state.qpos[:, self.driven :], contexts["goal"]
        way = goal - can
        ahead = way / (np.linalg.norm(way, axis=1, keepdims=True) + 0.02)
        tip, front = self.tip(state), self.front(state)
        behind = can - TIP_TO_CAN * ahead
        apart = np.concatenate([tip[:, :2] - behind, front[:, :2] - behind - 0.1 * ahead], axis=1)
        return np.concatenate([can - goal, 0.5 * apart, tip[:, 2:] - self.start[2]], axis=1)

    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """Distance (n,) from the can to the coaster in the table plane, meters."""
        return np.linalg.norm(state.qpos[:, self.driven :] - contexts["goal"], axis=1)
