"""An arm of Sawyer's published kinematics, masses and limits (Rethink Robotics' URDF), drawn as capsules.

At the frame sizes that are learned from, meshes would show nothing more. Why not dm_control's Kinova arm: the paper's
robot has seven joints, and that one six.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dm_control import mjcf

from stages.simulation.tasks.scene import NOTHING

GREY, RED = (0.45, 0.45, 0.48, 1), (0.5, 0.1, 0.1, 1)
TORQUE = 0.25  # share of the published torque limits that an action of 1 gives
ARMATURE = 0.1  # kg m^2
FRICTION = 0.0125  # dry friction over the torque limit: enough to hold a ladle of almonds
FLANGE = 0.0245  # metres from the last joint to what holds a tool
HOME = np.array([0.0, -1.18, 0.0, 2.18, 0.0, 0.57, 0.1745])  # radians: the hand points down, its front ahead


@dataclass(frozen=True)
class _Link:
    """A link, and the joint that turns it about its own z axis.

    Attributes:
        pos, quat: Where it sits in the link before, metres, and how it is turned.
        limits: Of the joint, radians.
        torque: Its limit, newton metres.
        speed: Its limit, radians a second.
        mass: Kilograms.
        fromto: Its capsule, in its own frame, metres.
        radius: Of the capsule, metres.
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
    """Add the arm, its foot at `base`, metres; returns the body of what holds a tool: its z axis points away.

    Gravity does not pull at it, as the robot's own controller has it. Damping is such that an action of 1 brings a
    joint to 95% of its published speed: dry friction takes the rest.
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
