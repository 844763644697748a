"""An arm with Sawyer's published kinematics, masses and limits (Rethink Robotics' URDF), rendered as capsules.

At the frame sizes used for learning, meshes would show no more detail. dm_control's Kinova arm is not used because it
has six joints, whereas the paper's robot has seven.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dm_control import mjcf

from stages.simulation.tasks.scene import NOTHING

GREY, RED = (0.45, 0.45, 0.48, 1), (0.5, 0.1, 0.1, 1)
TORQUE = 0.25  # torque of an action of 1, as a fraction of the published limit
ARMATURE = 0.1  # kg m^2
FRICTION = 0.0125  # dry friction as a fraction of the torque limit: enough to hold a ladle of almonds
FLANGE = 0.0245  # from the last joint to the tool flange, meters
HOME = np.array([0.0, -1.18, 0.0, 2.18, 0.0, 0.57, 0.1745])  # radians: the hand points down and its front points ahead


@dataclass(frozen=True)
class _Link:
    """A link and the joint that rotates it about its own z axis.

    Attributes:
        pos, quat: Position, meters, and orientation relative to the previous link.
        limits: Range of the joint, radians.
        torque: Torque limit, newton meters.
        speed: Speed limit, radians per second.
        mass: Kilograms.
        fromto: End points of the capsule in the link's frame, meters.
        radius: Radius of the capsule, meters.
    """

    pos: tuple[float, float, float]
    quat: tuple[float, float, float, float]
    limits: tuple[float, float]
    torque: float
    speed: float
    mass: float
    fromto: tuple[float, ...]
    radius: float


LINKS = (
    _Link((0, 0, 0.08), (1, 0, 0, 0), (-3.0503, 3.0503), 80, 1.74, 5.3213, (0, 0, 0, 0, 0, 0.25), 0.07),
    _Link((0.081, 0.05, 0.237), (1, -1, 1, 1), (-3.8095, 2.2736), 80, 1.328, 4.505, (0, 0, -0.06, 0, 0, 0.13), 0.068),
    _Link((0, -0.14, 0.1425), (1, 1, 0, 0), (-3.0426, 3.0426), 40, 1.957, 1.745, (0, 0, -0.15, 0, 0, 0.26), 0.055),
    _Link((0, -0.042, 0.26), (1, -1, 0, 0), (-3.0439, 3.0439), 40, 1.957, 2.5097, (0, 0, -0.115, 0, 0, 0.03), 0.055),
    _Link((0, -0.125, -0.1265), (1, 1, 0, 0), (-2.9761, 2.9761), 9, 3.485, 1.1136, (0, 0, -0.13, 0, 0, 0.27), 0.045),
    _Link((0, 0.031, 0.275), (1, -1, 0, 0), (-2.9761, 2.9761), 9, 3.485, 1.5625, (0, 0, 0.02, 0, -0.08, 0.1), 0.045),
    _Link(
        (0, -0.11, 0.1053),
        (0.0616248, 0.06163, -0.704416, 0.704416),
        (-4.7124, 4.7124),
        9,
        4.545,
        0.3292,
        (0, 0, -0.02, 0, 0, 0.02),
        0.04,
    ),
)
JOINTS = tuple(f"right_j{k}" for k in range(len(LINKS)))


def add_sawyer(root: mjcf.RootElement, base: tuple[float, float, float]) -> mjcf.Element:
    """Add the arm with its foot at `base`, meters; return the body of the tool flange, whose z axis points away.

    Gravity is compensated, as by the robot's own controller. With the chosen damping, an action of 1 drives a joint at
    95% of its published speed limit; dry friction accounts for the rest.
    """
    parent = root.worldbody.add("body", name="base", pos=base, gravcomp=1)
    parent.add(
        "geom", name="base", type="cylinder", size=(0.09, 0.05), pos=(0, 0, 0.05), rgba=RED, mass=2.0687, **NOTHING
    )
    for k, link in enumerate(LINKS):
        parent = parent.add("body", name=f"right_l{k}", pos=link.pos, quat=link.quat, gravcomp=1)
        joint = parent.add(
            "joint",
            name=JOINTS[k],
            type="hinge",
            axis=(0, 0, 1),
            limited=True,
            range=link.limits,
            armature=ARMATURE,
            frictionloss=FRICTION * link.torque,
            damping=TORQUE * link.torque / link.speed,
        )
        parent.add(
            "geom",
            name=f"right_l{k}",
            type="capsule",
            fromto=link.fromto,
            size=(link.radius,),
            mass=link.mass,
            rgba=GREY,
            **NOTHING,
        )
        root.actuator.add(
            "motor", name=f"motor_{k}", joint=joint, gear=(TORQUE * link.torque,), ctrllimited=True, ctrlrange=(-1, 1)
        )
    return parent.add("body", name="flange", pos=(0, 0, FLANGE), gravcomp=1)
