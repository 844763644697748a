"""sweep-paper and sweep-almonds: sweep crumpled paper, or a pile of almonds, into a dustpan (Sec. VI.D.2)."""

from __future__ import annotations

import numpy as np
from dm_control import mjcf

from stages.config.tasks import own_defaults
from stages.simulation.contexts import Contexts
from stages.simulation.task import State
from stages.simulation.tasks.household import YELLOW, Household, add_piece, plate
from stages.simulation.tasks.scene import NOTHING, add_wall

PAN_LOW, PAN_HIGH = np.array([0.1, -0.13]), np.array([0.27, 0.13])  # interior corners, meters; open at low x
PAN_WALL, PAN_HEIGHT = 0.008, 0.035  # half of a wall's thickness, and its height, meters
BRUSH = (0.006, 0.055)  # half thickness and half width, meters; there is a wing on each side
WING, WING_ANGLE = 0.02, np.radians(55)  # half width of a wing, meters, and its forward rotation
BEHIND = 0.07  # from the pile's center to the brush before it sweeps, meters
INSIDE = 0.06  # how far the brush enters the pan, meters

PILE = (np.array([-0.14, -0.1]), np.array([-0.04, 0.1]))  # corners of the range of the pile's center, meters
CANONICAL_PILE = np.array([-0.09, 0.0])
PAN = np.array([0.15, 0.35, 0.75])


class SweepReal(Household):
    """Common base of the two tasks. Context: azimuth, table, pile position and rotation, small noise on the arm.

    The distance is the fraction of the pieces outside the pan: a run's mean fraction inside is one minus the normalized
    distance.
    """

    start = (-0.27, 0.0, 0.025, 0.0, 0.0)
    pieces: int
    radius: float  # of a piece, meters
    height: float  # of a piece, meters
    mass: float  # kilograms
    damping: float  # friction with the table, N s/m
    rgb: np.ndarray
    shape: str
    spread: float  # radius of the pile, meters

    def add_tool(self, body: mjcf.Element) -> None:
        thick, wide = BRUSH
        plate(body, "brush", (0.0, 0.0), (thick, wide), 0.0)
        for side, name in ((1, "wing_left"), (-1, "wing_right")):
            at = (WING * np.sin(WING_ANGLE), side * (wide + WING * np.cos(WING_ANGLE)))
            plate(body, name, at, (thick, WING), -side * WING_ANGLE)

    def add_objects(self, root: mjcf.RootElement) -> None:
        middle, half = (PAN_LOW + PAN_HIGH) / 2, (PAN_HIGH - PAN_LOW) / 2
        floor = {"type": "box", "size": (*half, 0.002), "pos": (*middle, 0.002), "rgba": (*PAN, 1)}
        root.worldbody.add("geom", name="pan", **floor, **NOTHING)
        for name, centre, size in (
            ("pan_left", (middle[0], PAN_HIGH[1] + PAN_WALL), (half[0], PAN_WALL)),
            ("pan_right", (middle[0], PAN_LOW[1] - PAN_WALL), (half[0], PAN_WALL)),
            ("pan_back", (PAN_HIGH[0] + PAN_WALL, middle[1]), (PAN_WALL, half[1] + 2 * PAN_WALL)),
        ):
            add_wall(root, name, centre, size, PAN_HEIGHT, (*PAN, 1))
        for k in range(self.pieces):
            look = self.mass, self.damping, (*self.rgb, 1), self.shape
            add_piece(root, f"piece_{k}", self.radius, self.height, *look)

    def keep_clear(self) -> tuple[np.ndarray, ...]:
        return PAN, self.rgb, np.array(YELLOW[:3])

    def draw_objects(self, rng: np.random.Generator, n: int, vary: bool) -> Contexts:
        centre = rng.uniform(*PILE, (n, 2)) if vary else np.tile(CANONICAL_PILE, (n, 1))
        # Sunflower spirals fill a disc evenly, so that pieces do not overlap at the start.
        k = np.arange(self.pieces) + 0.5
        far, angle = self.spread * np.sqrt(k / self.pieces), k * np.pi * (1 + np.sqrt(5))
        turn = rng.uniform(0, 2 * np.pi, (n, 1)) if vary else np.zeros((n, 1))
        pile = np.stack([far * np.cos(angle + turn), far * np.sin(angle + turn)], axis=2)
        return {"pile": centre, "pieces": centre[:, None] + pile}

    def objects(self, contexts: Contexts) -> np.ndarray:
        return contexts["pieces"].reshape(len(contexts["pieces"]), -1)

    def waypoints(self, contexts: Contexts) -> list[tuple[float, np.ndarray]]:
        pile = contexts["pile"]
        mouth = np.array([PAN_LOW[0], 0.0])
        way = mouth - pile
        yaw = np.arctan2(way[:, 1], way[:, 0])
        ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)

        def pose(tip: np.ndarray, turned: np.ndarray) -> np.ndarray:
            return np.stack([tip[:, 0], tip[:, 1], np.full(len(tip), self.start[2]), turned, 0 * turned], axis=1)

        within = np.tile(mouth + np.array([INSIDE, 0.0]), (len(pile), 1))
        return [
            (0.3, pose(pile - BEHIND * ahead, yaw)),
            (0.65, pose(mouth - 0.06 * ahead, yaw)),
            (0.9, pose(within, 0 * yaw)),
        ]

    def goal_error(self, state: State, contexts: Contexts) -> np.ndarray:
        """Errors of the pieces from the interior of the pan, and of the tip from its pushing position and height."""
        pieces = self._pieces(state)
        apart = _apart(pieces, self.radius)
        tip = self.tip(state)
        far = np.linalg.norm(apart, axis=2)
        left = far / (far.sum(axis=1, keepdims=True) + 1e-3)
        middle = (left[:, :, None] * pieces).sum(axis=1)
        behind = np.where(left.sum(axis=1, keepdims=True) > 0.5, middle - [BEHIND, 0.0] - tip[:, :2], 0.0)
        share = 1 / np.sqrt(self.pieces)
        return np.concatenate([share * apart.reshape(len(tip), -1), 0.5 * behind, tip[:, 2:] - self.start[2]], axis=1)

    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """Fraction (n,) of the pieces outside the pan."""
        return (np.linalg.norm(_apart(self._pieces(state), self.radius), axis=2) > 1e-6).mean(axis=1)

    def _pieces(self, state: State) -> np.ndarray:
        """Positions of the pieces (n, pieces, 2), meters."""
        return state.qpos[:, self.driven :].reshape(len(state.qpos), self.pieces, 2)


class SweepPaper(SweepReal):
    """Sweep-paper: three crumpled sheets of paper."""

    name = "sweep-paper"
    defaults = own_defaults(name)
    pieces, radius, height, mass, damping = 3, 0.028, 0.056, 0.02, 0.6
    rgb, shape, spread = np.array([0.93, 0.92, 0.88]), "sphere", 0.058


class SweepAlmonds(SweepReal):
    """Sweep-almonds: a pile of eighteen almonds."""

    name = "sweep-almonds"
    defaults = own_defaults(name)
    pieces, radius, height, mass, damping = 18, 0.01, 0.02, 0.01, 0.3
    rgb, shape, spread = np.array([0.55, 0.3, 0.12]), "sphere", 0.058


def _apart(points: np.ndarray, radius: float) -> np.ndarray:
    """Offset (..., 2) of points from the nearest point inside the pan, past its open side by a piece's radius."""
    return points - np.clip(points, PAN_LOW + np.array([radius, 0.0]), PAN_HIGH)
