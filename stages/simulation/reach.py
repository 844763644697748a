"""Reach: a planar arm of three torque-driven hinges must bring its hand over a red disc (Sec. VI).

The paper gives no drawing of the arm. Here its base stands at the middle of the table, and both elbows bend to one
side only, as a person's do: with elbows free to bend either way an expert's choice would hang on its initial noise,
and no video of another context could tell which way this one goes.
"""

from __future__ import annotations

import numpy as np
from dm_control import mjcf

from stages.simulation.contexts import ContextDistribution, Contexts, camera_pose, draw_camera, draw_colours
from stages.simulation.task import State, Task

LINK_LENGTH = 0.4  # metres
LINK_RADIUS = 0.08
LINK_MASS = 0.5  # kilograms
HAND_RADIUS = 0.12
ARM_HEIGHT = 0.14  # of the links' axes above the table, metres
TABLE_HALF_SIZE = 1.3
GOAL_RADIUS = 0.14
TORQUE = 3.0  # newton metres at an action of 1
N_DISTRACTORS = 5
DISTRACTOR_RADIUS = 0.11
DISTRACTOR_PROBABILITY = 0.5

NOMINAL_QPOS = np.array([0.0, 0.9, 0.9])  # radians
INITIAL_NOISE = 0.1  # radians, half-width of the uniform noise on the initial joint angles
ELBOW_RANGE = (-0.3, 2.6)

GOAL_RANGE = (0.5, 1.1)  # metres from the arm's base
GOAL_ANGLE = (-0.6 * np.pi, 0.9 * np.pi)  # radians from the arm's nominal first link
GOAL_CLEARANCE = 0.5  # metres at least from the hand's nominal start

RED = np.array([1.0, 0.0, 0.0])
CANONICAL_TABLE = np.array([0.75, 0.72, 0.65])
CANONICAL_ARM = np.array([0.2, 0.3, 0.6])
CANONICAL_GOAL = np.array([0.1, -0.9])


def hand_position(qpos: np.ndarray) -> np.ndarray:
    """Forward kinematics: the hand's (n, 2) position over the table, metres, at joint angles (n, 3)."""
    angles = np.cumsum(qpos, axis=1)
    return LINK_LENGTH * np.stack([np.cos(angles).sum(axis=1), np.sin(angles).sum(axis=1)], axis=1)


class Reach(Task):
    """Reach, with the paper's timing: 0.01 s a physics step, 5 of them a control step, 50 control steps."""

    name = "reach"

    def build(self) -> mjcf.RootElement:
        root = mjcf.RootElement(model="reach")
        root.compiler.angle = "radian"
        root.option.timestep = 0.01
        root.option.gravity = (0, 0, 0)
        root.option.flag.contact = "disable"
        # At 48x48 shadows, multisampling and fine meshes would cost most of the time and show nothing.
        root.visual.quality.set_attributes(offsamples=0, shadowsize=0, numslices=12, numstacks=6, numquads=1)
        root.visual.headlight.set_attributes(ambient=(0.45,) * 3, diffuse=(0.55,) * 3, specular=(0, 0, 0))
        getattr(root.visual, "global").set_attributes(offwidth=1280, offheight=1280)
        world = root.worldbody
        world.add("camera", name="context", pos=(0, 0, 4), fovy=45)
        world.add("geom", name="table", type="box", size=(TABLE_HALF_SIZE, TABLE_HALF_SIZE, 0.05), pos=(0, 0, -0.05))
        for k in range(N_DISTRACTORS):
            # Each disc lies a little higher than the one before, so that overlapping ones do not flicker.
            world.add(
                "geom",
                name=f"distractor_{k}",
                type="cylinder",
                size=(DISTRACTOR_RADIUS, 0.004),
                pos=(0, 0, 0.006 + 0.004 * k),
            )
        world.add("geom", name="goal", type="cylinder", size=(GOAL_RADIUS, 0.01), pos=(0, 0, 0.03), rgba=(1, 0, 0, 1))

        parent = world
        for k, limits in enumerate([None, ELBOW_RANGE, ELBOW_RANGE]):
            at = (0, 0, ARM_HEIGHT) if k == 0 else (LINK_LENGTH, 0, 0)
            parent = parent.add("body", name=f"link_{k}", pos=at)
            limited = {} if limits is None else {"limited": True, "range": limits}
            hinge = parent.add(
                "joint", name=f"hinge_{k}", type="hinge", axis=(0, 0, 1), damping=1.0, armature=0.04, **limited
            )
            parent.add(
                "geom",
                name=f"link_{k}",
                type="capsule",
                fromto=(0, 0, 0, LINK_LENGTH, 0, 0),
                size=(LINK_RADIUS,),
                mass=LINK_MASS,
            )
            root.actuator.add(
                "motor", name=f"motor_{k}", joint=hinge, gear=(TORQUE,), ctrllimited=True, ctrlrange=(-1, 1)
            )
        parent.add("geom", name="hand", type="sphere", size=(HAND_RADIUS,), pos=(LINK_LENGTH, 0, 0), mass=0.1)
        parent.add("site", name="hand", pos=(LINK_LENGTH, 0, 0), size=(0.01,), rgba=(0, 0, 0, 0))
        return root

    def draw_contexts(self, rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
        vary = distribution.vary
        contexts = draw_camera(rng, n, distribution)
        if "colour" in vary:
            table = draw_colours(rng, n, RED)
            arm = draw_colours(rng, n, RED, table)
        else:
            table, arm = np.tile(CANONICAL_TABLE, (n, 1)), np.tile(CANONICAL_ARM, (n, 1))
        goal = _draw_goals(rng, n) if "goal" in vary else np.tile(CANONICAL_GOAL, (n, 1))
        noise = rng.uniform(-INITIAL_NOISE, INITIAL_NOISE, (n, 3)) if "initial" in vary else np.zeros((n, 3))
        positions, colours = _draw_distractors(rng, goal, table)
        visible = rng.random((n, N_DISTRACTORS)) < DISTRACTOR_PROBABILITY
        if "distractors" not in vary:
            visible[:] = False
        return contexts | {
            "table_rgb": table,
            "arm_rgb": arm,
            "goal": goal,
            "initial_qpos": NOMINAL_QPOS + noise,
            "distractor_position": positions,
            "distractor_rgb": colours,
            "distractor_visible": visible,
        }

    def model_fields(self, contexts: Contexts) -> dict[str, np.ndarray]:
        n = len(contexts["goal"])
        model = self.model
        camera_position, camera_quaternion = camera_pose(contexts)
        position = np.repeat(model.geom_pos[None], n, axis=0)
        rgba = np.repeat(model.geom_rgba[None], n, axis=0)
        rgba[:, model.geom("table").id, :3] = contexts["table_rgb"]
        for name in ("link_0", "link_1", "link_2", "hand"):
            rgba[:, model.geom(name).id, :3] = contexts["arm_rgb"]
        position[:, model.geom("goal").id, :2] = contexts["goal"]
        for k in range(N_DISTRACTORS):
            index = model.geom(f"distractor_{k}").id
            position[:, index, :2] = contexts["distractor_position"][:, k]
            rgba[:, index, :3] = contexts["distractor_rgb"][:, k]
            rgba[:, index, 3] = contexts["distractor_visible"][:, k]
        return {
            "cam_pos": camera_position[:, None],
            "cam_quat": camera_quaternion[:, None],
            "geom_pos": position,
            "geom_rgba": rgba,
        }

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

    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """From the hand to the disc's centre, in the table's plane."""
        return np.linalg.norm(state.site_xpos[:, 0, :2] - contexts["goal"], axis=1)


def _draw_goals(rng: np.random.Generator, n: int) -> np.ndarray:
    """Goals (n, 2) in the arm's reach, away from where the hand starts."""
    start = hand_position(NOMINAL_QPOS[None])

    def draw(m: int) -> np.ndarray:
        radius, angle = rng.uniform(*GOAL_RANGE, m), rng.uniform(*GOAL_ANGLE, m)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)

    goals = draw(n)
    while True:
        near = np.linalg.norm(goals - start, axis=1) < GOAL_CLEARANCE
        if not near.any():
            return goals
        goals[near] = draw(int(near.sum()))


def _draw_distractors(
    rng: np.random.Generator, goals: np.ndarray, table_rgb: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distractor discs inside the arm's workspace, not over the goal: positions (n, 5, 2) and colours (n, 5, 3)."""
    n = len(goals)
    centres = np.repeat(goals, N_DISTRACTORS, axis=0)

    def draw(m: int) -> np.ndarray:
        radius, angle = 1.1 * np.sqrt(rng.uniform(0.04, 1.0, m)), rng.uniform(0, 2 * np.pi, m)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)

    positions = draw(n * N_DISTRACTORS)
    while (near := np.linalg.norm(positions - centres, axis=1) < GOAL_RADIUS + DISTRACTOR_RADIUS).any():
        positions[near] = draw(int(near.sum()))
    table = np.repeat(table_rgb, N_DISTRACTORS, axis=0)
    colours = draw_colours(rng, n * N_DISTRACTORS, RED, table, gap=0.4)
    return positions.reshape(n, N_DISTRACTORS, 2), colours.reshape(n, N_DISTRACTORS, 3)
