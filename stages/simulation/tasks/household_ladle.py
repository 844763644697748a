"""ladle-almonds: carry almonds in a ladle to a pan and pour them by turning the wrist (Sec. VI.D.3).

This is the only household task with gravity: friction and gravity hold the almonds in the ladle, and almonds that leave
it too early stay on the table. The pan is a body with joints that nothing moves, so that its position is part of the
initial state of each context.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from dm_control import mjcf
from scipy.spatial.transform import Rotation

from stages.config.tasks import own_defaults
from stages.simulation.contexts import Contexts
from stages.simulation.task import State
from stages.simulation.tasks.household import Household
from stages.simulation.tasks.scene import NOTHING

ALMONDS, ALMOND_RADIUS, ALMOND_MASS = 15, 0.009, 0.0012  # meters, kilograms
BOWL_RADIUS, BOWL_DEPTH, SIDES = 0.036, 0.03, 10  # of the ladle, meters, and the number of plates in its wall
FLARE = np.radians(40)  # outward tilt of its wall
PAN_RADIUS, PAN_DEPTH, PAN_SIDES = 0.085, 0.035, 14
WALL = 0.004  # half of a wall's thickness, meters
LADLE_ROD = 0.6  # meters: longer than for other tools, to keep the arm out of the image
LIFT = 0.18  # height at which the ladle is carried, meters above the table
POUR = np.radians(100)  # rotation of the wrist; from 85 degrees on, all almonds fall
SETTLES = 1.0  # seconds until almonds dropped into the ladle come to rest

PAN_PLACES = (np.array([0.0, -0.12]), np.array([0.12, 0.12]))  # corners of the range of positions, meters
CANONICAL_PAN = np.array([0.06, 0.0])
LINING = 0.0005  # half thickness of the drawn lining of the bowl, meters
# White inside and blue outside: otherwise a bowl tilted toward the camera looks like one tilted away from it.
STEEL, BLUE, IRON, BROWN = (
    np.array([0.85, 0.87, 0.9]),
    np.array([0.1, 0.2, 0.6]),
    np.array([0.12, 0.12, 0.14]),
    np.array([0.6, 0.33, 0.13]),
)
TOUCHING = {"contype": 4, "conaffinity": 4, "condim": 3, "friction": (0.5, 0.005, 0.0001), "solref": (0.005, 1)}


class LadleAlmonds(Household):
    """Ladle-almonds. Context: azimuth, table, position of the pan, small noise on the arm's initial pose.

    The distance is the fraction of the almonds that are not in the pan.
    """

    name = "ladle-almonds"
    defaults = own_defaults(name)
    start = (-0.14, 0.0, LIFT, 0.0, 0.0)
    base = (-1.35, 0.0, 0.0)
    held = (0, 1, 0, 1)
    rod = (-LADLE_ROD, 0, 0)
    tilts = (1, 0, 0)
    home = np.array([0.0, -0.6, 0.0, 1.4, 0.0, -0.8, 0.1745])  # radians: the hand points ahead
    # Close and from above, because a distant camera confuses a lower ladle with one farther back; and from the side
    # that shows the pouring direction, because from the other side a ladle turned the wrong way looks nearly the same.
    filmed_from = (110.0, -55.0, 0.9, 42.0)
    substeps = 20

    def build(self) -> mjcf.RootElement:
        root = super().build()
        root.option.timestep = 0.0025
        root.option.gravity = (0, 0, -9.81)
        root.find("geom", "table").set_attributes(**TOUCHING)
        return root

    def add_tool(self, body: mjcf.Element) -> None:
        # The tip is the center of the bowl's floor.
        _add_dish(body, "bowl", BOWL_RADIUS, BOWL_DEPTH, SIDES, BLUE, FLARE, STEEL)

    def add_objects(self, root: mjcf.RootElement) -> None:
        pan = root.worldbody.add("body", name="pan", gravcomp=1)
        for axis, direction in (("x", (1, 0, 0)), ("y", (0, 1, 0))):
            pan.add("joint", name=f"pan_{axis}", type="slide", axis=direction, damping=1e5)
        _add_dish(pan, "pan", PAN_RADIUS, PAN_DEPTH, PAN_SIDES, IRON)
        for k in range(ALMONDS):
            almond = root.worldbody.add("body", name=f"almond_{k}")
            for axis, direction in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1))):
                almond.add("joint", name=f"almond_{k}_{axis}", type="slide", axis=direction, damping=0.001)
            look = {"type": "sphere", "size": (ALMOND_RADIUS,), "rgba": (*BROWN, 1), "mass": ALMOND_MASS}
            almond.add("geom", name=f"almond_{k}", **look, **TOUCHING)

    def keep_clear(self) -> tuple[np.ndarray, ...]:
        return STEEL, BLUE, IRON, BROWN

    def draw_objects(self, rng: np.random.Generator, n: int, vary: bool) -> Contexts:
        pan = rng.uniform(*PAN_PLACES, (n, 2)) if vary else np.tile(CANONICAL_PAN, (n, 1))
        return {"pan": pan}

    @cached_property
    def pile(self) -> np.ndarray:
        """Positions of the almonds at rest in the ladle (15, 3), meters from its tip, after being dropped into it."""
        import mujoco

        model = type(self)("hand").model if self._driver == "arm" else self.model
        data = mujoco.MjData(model)
        data.qpos[: len(self.start)] = self.start
        k = np.arange(ALMONDS)
        # Layers of five, each rotated relative to the layer below.
        angle, far = 2 * np.pi * k / 5 + 0.6 * (k // 5), 0.6 * (BOWL_RADIUS - ALMOND_RADIUS)
        height = ALMOND_RADIUS + 0.003 + 2.2 * ALMOND_RADIUS * (k // 5)
        drop = np.stack([far * np.cos(angle), far * np.sin(angle), height], axis=1)
        data.qpos[7:] = (drop + self.start[:3]).ravel()
        data.qpos[5:7] = CANONICAL_PAN
        data.ctrl[:] = self.demonstrated(np.asarray(self.start))
        mujoco.mj_step(model, data, round(SETTLES / model.opt.timestep))
        return data.qpos[7:].reshape(ALMONDS, 3) - data.site("tip").xpos

    def objects(self, contexts: Contexts) -> np.ndarray:
        n = len(contexts["pan"])
        almonds = np.tile((self.pile + np.asarray(self.start[:3])).ravel(), (n, 1))
        return np.concatenate([contexts["pan"], almonds], axis=1)

    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        """Initial state in each context. The almonds are placed in the ladle, whose pose includes the arm's noise."""
        import mujoco

        qpos, qvel = super().context_state(contexts)
        data = mujoco.MjData(self.model)
        for row in qpos:
            data.qpos[:] = row
            mujoco.mj_kinematics(self.model, data)
            tip = data.site("tip")
            row[self.driven + 2 :] = (tip.xpos + self.pile @ tip.xmat.reshape(3, 3).T).ravel()
        return qpos, qvel

    def waypoints(self, contexts: Contexts) -> list[tuple[float, np.ndarray]]:
        pan = contexts["pan"]

        def pose(y: np.ndarray, tilt: float) -> np.ndarray:
            zeros = np.zeros(len(pan))
            return np.stack([pan[:, 0], y, zeros + self.start[2], zeros, zeros + tilt], axis=1)

        # Almonds leave over the lowered side, half a bowl away.
        beside = pan[:, 1] + BOWL_RADIUS
        # The arm's last joint could not follow a faster motion.
        return [(0.35, pose(beside, 0.0)), (0.85, pose(beside, POUR))]

    def goal_error(self, state: State, contexts: Contexts) -> np.ndarray:
        """Error of each almond from the interior of the pan, and (with weight 1/4) of the tip from above the pan."""
        apart = self._apart(state)
        tip = self.tip(state)
        above = np.pad(self._pan(state), ((0, 0), (0, 1))) + np.array([0.0, BOWL_RADIUS, self.start[2]])
        return np.concatenate([apart.reshape(len(tip), -1) / np.sqrt(ALMONDS), 0.5 * (tip - above)], axis=1)

    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """Fraction (n,) of the almonds that are not in the pan."""
        return (np.linalg.norm(self._apart(state), axis=2) > 1e-6).mean(axis=1)

    def _pan(self, state: State) -> np.ndarray:
        return state.qpos[:, self.driven : self.driven + 2]

    def _apart(self, state: State) -> np.ndarray:
        """Offset (n, 15, 3) of each almond from the nearest point inside the pan, meters."""
        almonds = state.qpos[:, self.driven + 2 :].reshape(-1, ALMONDS, 3)
        aside = almonds[:, :, :2] - self._pan(state)[:, None]
        far = np.linalg.norm(aside, axis=2, keepdims=True)
        beyond = aside * np.maximum(1 - (PAN_RADIUS - WALL) / np.maximum(far, 1e-9), 0)
        above = np.maximum(almonds[:, :, 2:] - (PAN_DEPTH + ALMOND_RADIUS), 0)
        return np.concatenate([beyond, above], axis=2)


def _add_dish(
    body: mjcf.Element,
    name: str,
    radius: float,
    depth: float,
    sides: int,
    rgb: np.ndarray,
    flare: float = 0.0,
    lining: np.ndarray | None = None,
) -> None:
    """Add a round dish with a floor and a wall of plates to a body whose origin is the center of the dish's floor.

    Args:
        radius, depth: Interior radius at the floor, and interior depth, meters.
        sides: Number of plates in the wall.
        rgb: Color of the dish.
        flare: Outward tilt of the plates, radians.
        lining: Color of the interior if it differs.
    """
    look = {"rgba": (*rgb, 1), "mass": 0.01, **TOUCHING}
    floor = {"type": "cylinder", "size": (radius + 2 * WALL, WALL), "pos": (0, 0, WALL)}
    body.add("geom", name=f"{name}_floor", **floor, **look)
    seen = {} if lining is None else {"rgba": (*lining, 1), "mass": 1e-6, **NOTHING}
    if seen:
        drawn = {"type": "cylinder", "size": (radius, LINING), "pos": (0, 0, 2 * WALL + LINING)}
        body.add("geom", name=f"{name}_lining", **drawn, **seen)
    length = depth / np.cos(flare)
    width = (radius + 2 * WALL + depth * np.tan(flare)) * np.tan(np.pi / sides)  # the plates meet at the rim
    away = radius + WALL + depth * np.tan(flare) / 2
    for k in range(sides):
        angle = 2 * np.pi * k / sides
        at = (away * np.cos(angle), away * np.sin(angle), 2 * WALL + depth / 2)
        turned = Rotation.from_euler("ZY", (angle, flare)).as_quat(scalar_first=True)
        placed = {"type": "box", "size": (WALL, width, length / 2), "pos": at, "quat": turned}
        body.add("geom", name=f"{name}_{k}", **placed, **look)
        if seen:
            inwards = np.array([-np.cos(flare) * np.cos(angle), -np.cos(flare) * np.sin(angle), np.sin(flare)])
            drawn = {"type": "box", "size": (LINING, width, length / 2), "quat": turned}
            body.add("geom", name=f"{name}_lining_{k}", pos=at + (WALL + LINING) * inwards, **drawn, **seen)
