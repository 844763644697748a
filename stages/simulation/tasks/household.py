"""Common base of the household tasks (Sec. VI.D): a tool on a seven-joint arm, and a scripted person with that tool.

The tasks stand in for the paper's tasks on a real robot. Demonstrations show only the tool, moved by a hand outside the
image. The learner's arm is outside the image as well: the tool's rod is long, and the image is cropped around the
objects, as the paper crops its videos. Person and robot move differently: the person's hand is position-controlled, the
robot is torque-controlled.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import Any

import numpy as np
from dm_control import mjcf

from stages.simulation.contexts import ContextDistribution, Contexts, draw_camera, draw_colours
from stages.simulation.task import State, Task
from stages.simulation.tasks.fields import ModelFields
from stages.simulation.tasks.sawyer import HOME, JOINTS, add_sawyer
from stages.simulation.tasks.scene import ARM, HIDDEN_GROUP, NOTHING, OBJECT, add_table, make_scene

ROD = 0.4  # length of a tool's rod, meters: whatever holds it is outside the image
ROD_RADIUS = 0.012
TABLE_HALF_SIZE = 1.5
SIDEWAYS = 45.0  # maximum deviation of the camera's azimuth to either side, degrees

HAND_REACH = np.array([0.5, 0.5, 0.5, np.pi, np.pi])  # hand poses commanded by actions of 1: meters and radians
HAND_GAIN, HAND_DAMPING = 400.0, 40.0  # a 1 kg hand follows within 0.1 s
COLLIDER_HEIGHT = 0.05  # minimum height of the pieces' colliders, meters
YELLOW = (0.9, 0.75, 0.1, 1)
BACKING = 0.02  # half thickness of the colliders of a tool's plates, meters
TREMBLE = np.array([0.006, 0.006, 0.003, 0.04, 0.02])  # standard deviation of a person's waypoints, meters and radians
TEMPO = 0.04  # standard deviation of the times of waypoints, as a fraction of the episode
ARM_NOISE = 0.025  # radians, half-width of the uniform noise on the arm's initial joint angles

TABLES = ("plain", "checks", "tiles", "stripes")  # textures
CANONICAL_TABLE = np.array([0.55, 0.45, 0.35])


class Household(Task):
    """A task with a tool and the same timing as the other tasks.

    Poses of the tool are rows (x, y, z, yaw, tilt): position of its tip, meters, direction of its front, and rotation
    about its own axis `tilts`, radians. The policy observes the arm's joints, the positions of the tool's tip and
    front, and the time.
    """

    # Elevation and distance do not vary: from higher up or farther away, the arm would be visible.
    factors = ("azimuth", "colour", "goal", "initial")
    default_factors = ("azimuth", "colour", "goal", "initial")
    oversampling = 3
    start: tuple[float, ...]  # initial pose of the tool
    base: tuple[float, float, float] = (-0.6, 0.0, 0.1)  # base of the arm, meters
    held: tuple[float, float, float, float] = (0, 1, 0, 0)  # orientation of the tool relative to the flange
    rod: tuple[float, float, float] = (0, 0, ROD)  # from the tool's tip to the flange, meters
    tilts: tuple[int, int, int] = (0, 1, 0)
    home: np.ndarray = HOME  # initial guess of inverse kinematics, radians
    # The camera's mean azimuth, its elevation, distance and field of view; degrees and meters.
    filmed_from: tuple[float, float, float, float] = (180.0, -35.0, 1.8, 18.0)

    def __init__(self, driver: str = "arm"):
        """Create the task. `driver` moves the tool: the robot's `arm`, or a person's `hand`."""
        self._driver = driver

    @property
    def demonstrator(self) -> Household | None:
        return type(self)("hand") if self._driver == "arm" else None

    @abstractmethod
    def add_tool(self, body: mjcf.Element) -> None:
        """Add the tool's geoms to a body with its origin at the tip, the front along x, and up along z."""

    @abstractmethod
    def add_objects(self, root: mjcf.RootElement) -> None:
        """Add the objects on the table and their joints."""

    @abstractmethod
    def draw_objects(self, rng: np.random.Generator, n: int, vary: bool) -> Contexts:
        """Draw the positions of the objects."""

    @abstractmethod
    def objects(self, contexts: Contexts) -> np.ndarray:
        """Initial joint positions (n, m) of the objects."""

    @abstractmethod
    def waypoints(self, contexts: Contexts) -> list[tuple[float, np.ndarray]]:
        """Waypoints of a person's motion after the start: fraction of the episode, and pose of the tool (n, 5)."""

    def build(self) -> mjcf.RootElement:
        root = make_scene(self.name)
        root.find("camera", "context").fovy = self.filmed_from[3]
        _add_textures(root)
        add_table(root, TABLE_HALF_SIZE, rgba=(*CANONICAL_TABLE, 1), contype=0, conaffinity=ARM["contype"])
        if self._driver == "arm":
            flange = add_sawyer(root, self.base)
            tool = flange.add(
                "body", name="tool", pos=(0, 0, float(np.linalg.norm(self.rod))), quat=self.held, gravcomp=1
            )
        else:
            tool = _add_hand(root, self.tilts)
        rod = {"type": "capsule", "size": (ROD_RADIUS,), "rgba": (0.25, 0.2, 0.15, 1), "mass": 0.1}
        tool.add("geom", name="rod", fromto=(*0.15 * np.asarray(self.rod), *self.rod), **rod, **NOTHING)
        tool.add("site", name="tip", pos=(0, 0, 0), size=(0.005,), rgba=(0, 0, 0, 0))
        tool.add("site", name="front", pos=(0.1, 0, 0), size=(0.005,), rgba=(0, 0, 0, 0))
        self.add_tool(tool)
        self.add_objects(root)
        return root

    @cached_property
    def driven(self) -> int:
        """Number of joints of the arm or the hand. The objects' joints come after them."""
        return int(self.model.nu)

    @cached_property
    def initial(self) -> np.ndarray:
        """Joint positions of the arm or hand with the tool in its initial pose."""
        start = np.asarray(self.start)
        return start if self._driver == "hand" else self.postures(start[None])[0]

    def draw_contexts(self, rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
        vary = self.varied(distribution)
        contexts = draw_camera(rng, n, distribution, vary, *self.filmed_from[1:3])
        low, high = distribution.azimuth
        middle, half = (low + high) / 2, max((high - low) / 2, 1e-9)
        aside = (contexts["azimuth"] - middle) / half * min(half, SIDEWAYS)  # There is a wall behind the robot.
        contexts["azimuth"] = self.filmed_from[0] + (aside if "azimuth" in vary else np.zeros(n))
        if "colour" in vary:
            colours, kinds = draw_colours(rng, n, *self.keep_clear()), rng.integers(len(TABLES), size=n)
        else:
            colours, kinds = np.tile(CANONICAL_TABLE, (n, 1)), np.zeros(n, int)
        noise = rng.uniform(-1, 1, (n, len(JOINTS))) * (ARM_NOISE if "initial" in vary else 0)
        objects = self.draw_objects(rng, n, "goal" in vary)
        return contexts | objects | {"table_rgb": colours, "table_texture": kinds, "arm_noise": noise}

    def keep_clear(self) -> tuple[np.ndarray, ...]:
        """Colors (3,) that the table must differ from."""
        return ()

    def model_fields(self, contexts: Contexts) -> dict[str, np.ndarray]:
        fields = ModelFields(self.model, contexts).colour(contexts["table_rgb"], "table")
        materials = np.repeat(self.model.geom_matid[None], len(contexts["table_rgb"]), axis=0)
        materials[:, self.model.geom("table").id] = [
            self.model.material(TABLES[kind]).id for kind in contexts["table_texture"]
        ]
        return self.place(fields, contexts).done() | {"geom_matid": materials}

    def place(self, fields: ModelFields, contexts: Contexts) -> ModelFields:
        """Place the fixed objects whose positions depend on the context."""
        return fields

    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        objects = self.objects(contexts)
        own = np.tile(self.initial, (len(objects), 1))
        if self._driver == "arm":
            own = own + contexts["arm_noise"]
        qpos = np.concatenate([own, objects], axis=1)
        return qpos, np.zeros((len(qpos), self.model.nv))

    def draw_states(self, rng: np.random.Generator, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        noise = rng.uniform(-ARM_NOISE, ARM_NOISE, contexts["arm_noise"].shape)
        return self.context_state(contexts | {"arm_noise": noise})

    def observe(self, state: State) -> np.ndarray:
        phase = (state.time / self.horizon)[:, None]
        own = [state.qpos[:, : self.driven], state.qvel[:, : self.driven]]
        return np.concatenate([*own, self.tip(state), self.front(state), phase], axis=1).astype(np.float32)

    def observe_expert(self, state: State, contexts: Contexts) -> np.ndarray:
        objects = [state.qpos[:, self.driven :], state.qvel[:, self.driven :]]
        return np.concatenate([self.observe(state), *objects, self.goal_error(state, contexts)], axis=1).astype(
            np.float32
        )

    def expert_reward(self, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        """Reward (n,): negative squared goal error, minus a small penalty on effort."""
        error = np.square(self.goal_error(state, contexts)).sum(axis=1)
        return -error - 0.01 * np.square(action).sum(axis=1)

    def tip(self, state: State) -> np.ndarray:
        """Position of the tool's tip (n, 3), meters."""
        return state.site_xpos[:, self.model.site("tip").id]

    def front(self, state: State) -> np.ndarray:
        """Position of a point 10 cm in front of the tip (n, 3), meters."""
        return state.site_xpos[:, self.model.site("front").id]

    def path(self, contexts: Contexts, rng: np.random.Generator | None = None) -> np.ndarray:
        """The tool's poses (K + 1, n, 5) at every control step of a person's motion; `rng` adds natural variation.

        Between waypoints the hand follows a minimum-jerk trajectory, like a human hand (Flash and Hogan, 1985).
        """
        n = len(contexts["table_rgb"])
        way = [(0.0, np.tile(self.start, (n, 1))), *self.waypoints(contexts)]
        times = np.stack([np.full(n, share) for share, _ in way])
        poses = np.stack([pose for _, pose in way])
        if rng is not None:
            times[1:] += TEMPO * rng.standard_normal(times[1:].shape)
            times = np.clip(np.maximum.accumulate(times, axis=0), 0.0, 0.97)
            poses[1:] += TREMBLE * rng.standard_normal(poses[1:].shape)
        path = np.empty((self.control_steps + 1, *poses.shape[1:]))
        for step in range(self.control_steps + 1):
            path[step] = poses[0]
            for k in range(1, len(poses)):
                lasts = np.maximum(times[k] - times[k - 1], 1e-6)
                done = np.clip((step / self.control_steps - times[k - 1]) / lasts, 0, 1)
                done = (done**3 * (10 - 15 * done + 6 * done**2))[:, None]
                path[step] += done * (poses[k] - poses[k - 1])
        return path

    def plan(self, contexts: Contexts, rng: np.random.Generator | None = None) -> np.ndarray:
        return self.demonstrated(self.path(contexts, rng)[1:])

    def demonstrated(self, poses: np.ndarray) -> np.ndarray:
        """The actions (..., 5) with which a hand moves the tool to `poses`."""
        return poses / HAND_REACH

    def kinesthetic(self, contexts: Contexts) -> np.ndarray:
        poses = self.path(contexts)[: self.control_steps : self.frame_every]
        if len(poses[0]) != 1:
            raise ValueError("a kinesthetic demonstration needs exactly one context")
        qpos = np.zeros((len(poses), self.model.nq))
        qpos[:, : self.driven] = self.postures(poses[:, 0])
        return qpos

    def postures(self, poses: np.ndarray) -> np.ndarray:
        """The arm's joint positions (T, 7), radians, for a sequence of tool poses (T, 5), by inverse kinematics."""
        from dm_control.utils.inverse_kinematics import qpos_from_site_pose

        physics = mjcf.Physics.from_mjcf_model(self.build())
        physics.data.qpos[: len(HOME)] = self.home
        postures = []
        for pose in poses:
            found = qpos_from_site_pose(
                physics, "tip", pose[:3], self._turned(*pose[3:]), joint_names=JOINTS, tol=1e-6, inplace=True
            )
            if not found.success:
                raise ValueError(f"the arm cannot move the tool to {pose}")
            postures.append(physics.data.qpos[: len(HOME)].copy())
        return np.stack(postures)

    def _turned(self, yaw: float, tilt: float) -> np.ndarray:
        """Unit quaternion, scalar first, of a tool with this yaw and tilt."""
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_euler("z", yaw) * Rotation.from_rotvec(tilt * np.asarray(self.tilts, float))
        return turned.as_quat()[[3, 0, 1, 2]]


def _add_textures(root: mjcf.RootElement) -> None:
    """Add the tables' materials, which a context's color tints."""
    light, dark = (1, 1, 1), (0.7, 0.7, 0.7)
    for name, kind, repeat in (
        ("plain", "flat", (1, 1)),
        ("checks", "checker", (24, 24)),
        ("tiles", "checker", (8, 8)),
        ("stripes", "gradient", (12, 1)),
    ):
        texture = root.asset.add(
            "texture", name=name, type="2d", builtin=kind, rgb1=light, rgb2=dark, width=64, height=64
        )
        root.asset.add("material", name=name, texture=texture, texrepeat=repeat, specular=0)


def _add_hand(root: mjcf.RootElement, tilts: tuple[int, int, int]) -> mjcf.Element:
    """Add a person's hand: five position-controlled joints. Return the tool's body."""
    body = root.worldbody.add("body", name="tool", gravcomp=1)
    joints: tuple[tuple[str, str, tuple[int, int, int]], ...] = (
        ("x", "slide", (1, 0, 0)),
        ("y", "slide", (0, 1, 0)),
        ("z", "slide", (0, 0, 1)),
        ("yaw", "hinge", (0, 0, 1)),
        ("tilt", "hinge", tilts),
    )
    for k, (name, kind, axis) in enumerate(joints):
        joint = body.add("joint", name=f"hand_{name}", type=kind, axis=axis, armature=1.0)
        reach = float(HAND_REACH[k])
        root.actuator.add(
            "general",
            name=f"hand_{name}",
            joint=joint,
            gainprm=(HAND_GAIN * reach,),
            biastype="affine",
            biasprm=(0, -HAND_GAIN, -HAND_DAMPING),
            ctrllimited=True,
            ctrlrange=(-1, 1),
        )
    return body


def plate(body: mjcf.Element, name: str, at: tuple[float, float], half: tuple[float, float], turned: float) -> None:
    """Add an upright plate, 8 cm high, to a tool. Its collider extends to the back, so that pieces cannot slip through.

    Args:
        at: Position of its center relative to the tip, forward and sideways, meters.
        half: Half thickness and half width, meters.
        turned: Rotation about the vertical axis, radians.
    """
    placed: dict[str, Any] = {"type": "box", "euler": (0, 0, turned)}
    body.add("geom", name=name, size=(*half, 0.04), pos=(*at, 0.04), rgba=YELLOW, mass=0.05, **placed, **NOTHING)
    more = BACKING - half[0]
    behind = (at[0] - more * np.cos(turned), at[1] - more * np.sin(turned), 0.04)
    thick = (BACKING, half[1], 0.04)
    body.add("geom", name=f"{name}_collider", size=thick, pos=behind, mass=0, group=HIDDEN_GROUP, **placed, **ARM)


def add_piece(
    root: mjcf.RootElement,
    name: str,
    radius: float,
    height: float,
    mass: float,
    damping: float,
    rgba: tuple[float, ...],
    shape: str,
) -> None:
    """Add a piece that slides on the table: joints `NAME_x` and `NAME_y`.

    Args:
        radius, height: Rendered size, meters. The collider is a capsule at least 5 cm high, so that no piece slips
            under a tool that is held slightly above the table.
        mass: Kilograms.
        damping: Friction with the table, N s/m.
        shape: Rendered shape: `sphere` or `cylinder`.
    """
    body = root.worldbody.add("body", name=name, pos=(0, 0, 0))
    for axis, direction in (("x", (1, 0, 0)), ("y", (0, 1, 0))):
        body.add("joint", name=f"{name}_{axis}", type="slide", axis=direction, damping=damping)
    top = max(height, COLLIDER_HEIGHT, 2.2 * radius) - radius
    collider: dict[str, Any] = {"type": "capsule", "size": (radius,), "fromto": (0, 0, radius, 0, 0, top)}
    body.add("geom", name=f"{name}_collider", mass=mass, group=HIDDEN_GROUP, **collider, **OBJECT)
    size = {"sphere": (radius,), "cylinder": (radius, height / 2)}
    body.add("geom", name=name, type=shape, size=size[shape], pos=(0, 0, height / 2), rgba=rgba, mass=0, **NOTHING)
