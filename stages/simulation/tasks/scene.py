"""Common parts of the simulated scenes: quality, light, camera, table, arms, sliding objects and walls.

All motion is in the table plane. Moving bodies collide as spheres and capsules whose axes are at the same height, so
that contacts are exact, cheap and stable at the paper's timestep, and frictionless as in the paper. Friction with the
table is modeled as damping of an object's two joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dm_control import mjcf

from stages.simulation.contexts import N_DISTRACTORS

TABLE_THICKNESS = 0.05  # half thickness, meters
HEIGHT = 0.14  # height of all colliders' centers above the table, meters
RIM_HEIGHT = 0.04  # rendered height of the table's rim, meters
HIDDEN_GROUP = 4  # geoms in this group collide but are not rendered

# Collisions: arms with objects only, objects with each other and with walls.
NOTHING = {"contype": 0, "conaffinity": 0}
# Harder than MuJoCo's default, so that a ball squeezed between arm and wall penetrates them less.
HARD = {"condim": 1, "solimp": (0.95, 0.99, 0.001)}
ARM = {"contype": 1, "conaffinity": 0, **HARD}
OBJECT = {"contype": 2, "conaffinity": 3, **HARD}
WALL = {"contype": 2, "conaffinity": 0, **HARD}


@dataclass(frozen=True)
class Arm:
    """A planar arm with torque-driven hinges.

    Attributes:
        lengths: Lengths of the links, meters.
        base: Position of the base on the table (2,), meters.
        limits: Range of each hinge, radians; None for an unlimited hinge.
        radius: Radius of the links, meters.
        mass: Mass of each link, kilograms.
        torque: Torque for an action of 1, newton meters.
    """

    lengths: tuple[float, ...]
    base: tuple[float, float] = (0.0, 0.0)
    limits: tuple[tuple[float, float] | None, ...] = ()
    radius: float = 0.08
    mass: float = 0.5
    torque: float = 3.0

    def build(self, root: mjcf.RootElement, **geom: object) -> mjcf.Element:
        """Add the arm with its joints `hinge_K`, geoms `link_K` and motors; return the last link's body."""
        parent = root.worldbody
        ends = (0.0, *self.lengths[:-1])
        for k, (start, length) in enumerate(zip(ends, self.lengths, strict=True)):
            at = (*self.base, HEIGHT) if k == 0 else (start, 0, 0)
            parent = parent.add("body", name=f"link_{k}", pos=at)
            limits = self.limits[k] if k < len(self.limits) else None
            limited = {} if limits is None else {"limited": True, "range": limits}
            hinge = parent.add(
                "joint", name=f"hinge_{k}", type="hinge", axis=(0, 0, 1), damping=1.0, armature=0.04, **limited
            )
            parent.add(
                "geom",
                name=f"link_{k}",
                type="capsule",
                fromto=(0, 0, 0, length, 0, 0),
                size=(self.radius,),
                mass=self.mass,
                **geom,
            )
            root.actuator.add(
                "motor", name=f"motor_{k}", joint=hinge, gear=(self.torque,), ctrllimited=True, ctrlrange=(-1, 1)
            )
        return parent

    def hand(self, qpos: np.ndarray) -> np.ndarray:
        """Forward kinematics: position of the last link's end (n, 2), meters, for joint angles (n, links)."""
        angles = np.cumsum(qpos, axis=1)
        lengths = np.asarray(self.lengths)
        ends = np.stack([(lengths * np.cos(angles)).sum(axis=1), (lengths * np.sin(angles)).sum(axis=1)], axis=1)
        return ends + self.base


def make_scene(name: str, timestep: float = 0.01) -> mjcf.RootElement:
    """Create an empty scene with the context's camera, one light from above, and rendering quality for learning.

    At 48x48, shadows, multisampling and fine meshes would take most of the time without being visible. The light casts
    shadows only if a viewer restores MuJoCo's default quality.

    Args:
        name: Name of the model.
        timestep: Seconds per physics step.
    """
    root = mjcf.RootElement(model=name)
    root.compiler.angle = "radian"
    root.option.timestep = timestep
    root.option.gravity = (0, 0, 0)
    root.visual.quality.set_attributes(offsamples=0, shadowsize=0, numslices=12, numstacks=6, numquads=1)
    root.visual.headlight.set_attributes(ambient=(0.45,) * 3, diffuse=(0.25,) * 3, specular=(0, 0, 0))
    getattr(root.visual, "global").set_attributes(offwidth=1280, offheight=1280)
    world = root.worldbody
    world.add("camera", name="context", pos=(0, 0, 4), fovy=45)
    world.add("light", name="above", directional=True, pos=(0, 0, 4), dir=(0, 0, -1), diffuse=(0.35,) * 3)
    return root


def add_table(root: mjcf.RootElement, half_size: float, **geom: object) -> mjcf.Element:
    """Add a square table whose top is the plane z = 0; return its geom."""
    size = (half_size, half_size, TABLE_THICKNESS)
    return root.worldbody.add("geom", name="table", type="box", size=size, pos=(0, 0, -TABLE_THICKNESS), **geom)


def add_distractors(root: mjcf.RootElement, radius: float, **geom: object) -> None:
    """Add flat discs `distractor_K`, each slightly higher than the previous one to avoid z-fighting."""
    for k in range(N_DISTRACTORS):
        at = (0, 0, 0.006 + 0.004 * k)
        root.worldbody.add("geom", name=f"distractor_{k}", type="cylinder", size=(radius, 0.004), pos=at, **geom)


def add_goal(root: mjcf.RootElement, radius: float, **geom: object) -> None:
    """Add a red disc named `goal`."""
    root.worldbody.add(
        "geom", name="goal", type="cylinder", size=(radius, 0.01), pos=(0, 0, 0.03), rgba=(1, 0, 0, 1), **geom
    )


def add_object(
    root: mjcf.RootElement, name: str, radius: float, mass: float, damping: float, rgba: Sequence[float], shape: str
) -> None:
    """Add an object that slides on the table, with joints `NAME_x` and `NAME_y` and a site NAME.

    Args:
        radius: Radius of the object, meters.
        mass: Kilograms.
        damping: Friction with the table, N s/m. After a push the object stops within about `mass / damping` seconds.
        shape: Rendered shape: `sphere` or `cylinder`.
    """
    body = root.worldbody.add("body", name=name, pos=(0, 0, HEIGHT))
    for axis, direction in (("x", (1, 0, 0)), ("y", (0, 1, 0))):
        body.add("joint", name=f"{name}_{axis}", type="slide", axis=direction, damping=damping)
    body.add("geom", name=f"{name}_collider", type="sphere", size=(radius,), mass=mass, group=HIDDEN_GROUP, **OBJECT)
    size, at = ((radius,), radius - HEIGHT) if shape == "sphere" else ((radius, HEIGHT), 0.0)
    body.add("geom", name=name, type=shape, size=size, pos=(0, 0, at), rgba=rgba, mass=0, **NOTHING)
    body.add("site", name=name, pos=(0, 0, 0), size=(0.01,), rgba=(0, 0, 0, 0))


def add_wall(
    root: mjcf.RootElement,
    name: str,
    centre: tuple[float, float],
    half_size: tuple[float, float],
    height: float,
    rgba: Sequence[float],
) -> None:
    """Add a wall that objects cannot pass: rendered `height` meters high, colliding at the colliders' height."""
    world = root.worldbody
    world.add(
        "geom",
        name=name,
        type="box",
        size=(*half_size, height / 2),
        pos=(*centre, height / 2),
        rgba=rgba,
        **NOTHING,
    )
    world.add(
        "geom",
        name=f"{name}_collider",
        type="box",
        size=(*half_size, HEIGHT),
        pos=(*centre, HEIGHT),
        group=HIDDEN_GROUP,
        **WALL,
    )


def add_rim(root: mjcf.RootElement, half_size: float, rgba: Sequence[float]) -> None:
    """Add walls around a square table of `half_size` meters. Their inner sides are flush with its edge."""
    thick = 0.1  # half thickness: larger than the distance of the fastest object in one physics step
    for axis, sign, name in ((0, -1, "west"), (0, 1, "east"), (1, -1, "south"), (1, 1, "north")):
        centre, size = [0.0, 0.0], [half_size + 2 * thick] * 2
        centre[axis], size[axis] = sign * (half_size + thick), thick
        add_wall(root, f"rim_{name}", (centre[0], centre[1]), (size[0], size[1]), RIM_HEIGHT, rgba)
