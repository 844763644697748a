"""Tasks of dm_control's suite as tasks of this package: `dm:reacher-easy`, `dm:finger-turn_hard` etc.

The batch simulation steps the suite's own model. Expert observations and rewards come from the suite's own code, which
runs on a single dm_control physics. Each simulation's state is written into it in turn, a few thousand times per
second. Touch and force sensors are therefore evaluated at the state itself, whereas dm_control reports their values
from within the last physics step. Tasks are refused if their physics change between episodes, their actuators have an
internal state (dog, quadruped), or their actions are not limited to [-1, 1] (lqr).

A context varies the camera (rotated about the vertical axis through the point that it looks at) and the colors of all
materials except the target's. The position of the target is also part of the context. The distance is
1 - return / 1000: the fraction of the maximum return that was missed.
"""

from __future__ import annotations

import copy
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from artifacts.errors import UsageError
from stages.config.tasks import own_defaults
from stages.simulation.contexts import RED, ContextDistribution, Contexts, draw_camera, draw_colours
from stages.simulation.task import State, Task

if TYPE_CHECKING:
    import mujoco
    from dm_control import mjcf

PREFIX = "dm:"
CONTROL_STEPS = 1000  # per episode of the suite
FRAMES = 25
JOINT_NOISE = 0.02  # half-width of the noise on hinges and slides within a context, radians or meters
CAMERA = 0
# Model fields in which the suite's tasks store what they draw for an episode.
DRAWN_FIELDS = (
    "body_pos",
    "body_quat",
    "geom_pos",
    "geom_size",
    "geom_rgba",
    "site_pos",
    "site_size",
    "site_rgba",
    "light_pos",
)
COLOUR_GAP = 0.35


class DmTask(Task):
    """A task of dm_control's suite. Success is a distance below 0.5, which is a return above 500."""

    defaults = own_defaults(PREFIX)
    factors = ("azimuth", "elevation", "distance", "colour", "initial")
    default_factors = ("azimuth", "colour", "initial")
    control_steps = CONTROL_STEPS
    frame_every = CONTROL_STEPS // FRAMES
    camera = CAMERA
    truncates = True
    expert_threshold = 0.5

    def __init__(self, name: str):
        """Load `dm:DOMAIN-TASK`.

        Raises:
            UsageError: The suite has no such task, or the task is not supported.
        """
        import logging

        from dm_control import suite

        logging.getLogger("absl").setLevel(logging.ERROR)  # The suite's models use deprecated features.
        domain, _, task = name.removeprefix(PREFIX).partition("-")
        if (domain, task) not in suite.ALL_TASKS:
            some = ", ".join(f"{PREFIX}{d}-{t}" for d, t in sorted(suite.EASY))
            raise UsageError(f"dm_control's suite has no {name!r}: expected {PREFIX}DOMAIN-TASK, for example {some}")
        self.name = name
        self._env = suite.load(domain, task, task_kwargs={"random": 0})
        self.substeps = round(self._env.control_timestep() / self._env.physics.timestep())
        self._refuse_what_the_batch_cannot()
        self._seen: tuple[State, Contexts, np.ndarray, np.ndarray] | None = None

    def _refuse_what_the_batch_cannot(self) -> None:
        """Raise UsageError if the batch simulation could not reproduce the suite's physics.

        The suite's model is left as in an episode with seed 0, including everything that a task sets in each episode.
        """
        physics, task = self._env.physics, self._env.task
        model = physics.model.ptr
        if model.na:
            raise UsageError(f"{self.name}: its actuators have an internal state, which is not supported")
        if not (model.actuator_ctrllimited.all() and (model.actuator_ctrlrange == [-1, 1]).all()):
            raise UsageError(f"{self.name}: its actions are not limited to [-1, 1], which is not supported")
        names = [name for name in dir(model) if isinstance(getattr(model, name, None), np.ndarray)]
        seen = []
        for seed in (2, 1, 0):
            task._random = np.random.RandomState(seed)
            with physics.reset_context():
                task.initialize_episode(physics)
            seen.append({name: np.array(getattr(model, name)) for name in names})
        for name in names:
            differ = np.not_equal(seen[0][name], seen[1][name]) | np.not_equal(seen[1][name], seen[2][name])
            if np.any(differ) and not self._harmless(name, np.asarray(differ)):
                raise UsageError(f"{self.name}: its physics ({name}) change between episodes, which is not supported")

    def _harmless(self, name: str, differ: np.ndarray) -> bool:
        """Whether a difference between episodes, a mask over a model field, does not affect the physics."""
        import mujoco

        model = self._env.physics.model.ptr
        contacts = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
        touches = np.asarray((model.geom_contype != 0) | (model.geom_conaffinity != 0)) & contacts
        which: np.ndarray = np.atleast_1d(differ.reshape(len(differ), -1).any(axis=1))
        if name.startswith("body_"):
            return name in DRAWN_FIELDS and not touches[which[model.geom_bodyid]].any()
        if name in ("geom_pos", "geom_size"):
            return not touches[which].any()
        return name in DRAWN_FIELDS

    def build(self) -> mjcf.RootElement:
        """The suite has no MJCF tree of this package.

        Raises:
            NotImplementedError: Always; use `model`.
        """
        raise NotImplementedError("the suite's models are already compiled: use `model`")

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The suite's model with rendering quality for learning and a camera that can be placed freely."""
        model = copy.copy(self._env.physics.model.ptr)
        quality = model.vis.quality
        quality.offsamples = quality.shadowsize = 0
        quality.numslices, quality.numstacks, quality.numquads = 12, 6, 1
        model.cam_pos[CAMERA], model.cam_mat0[CAMERA] = self._camera[0], self._camera[1].ravel()
        if not self._follows:
            model.cam_bodyid[CAMERA] = model.cam_mode[CAMERA] = 0
        return model

    @cached_property
    def _follows(self) -> bool:
        """Whether the suite's camera tracks a body."""
        return bool(self._env.physics.model.cam_mode[CAMERA] != 0)

    @cached_property
    def _camera(self) -> tuple[np.ndarray, np.ndarray]:
        """The suite's own camera: position (3,), relative to the center of mass of a tracked body; frame (3, 3)."""
        physics = self._env.physics
        with physics.reset_context():
            pass
        position, frame = np.array(physics.data.cam_xpos[CAMERA]), np.array(physics.data.cam_xmat[CAMERA]).reshape(3, 3)
        if self._follows:
            position = position - physics.data.subtree_com[physics.model.cam_bodyid[CAMERA]]
        return position, frame

    @cached_property
    def _pivot(self) -> np.ndarray:
        """The point (3,) that the camera looks at and rotates about."""
        position, frame = self._camera
        forward = -frame[:, 2]
        centre = np.zeros(3) if self._follows else np.array(self._env.physics.model.stat.center)
        return position + forward * max(float((centre - position) @ forward), 0.1)

    def draw_contexts(self, rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
        vary = self.varied(distribution)
        camera = draw_camera(rng, n, distribution, vary, elevation=0.0, distance=1.0)
        if "elevation" in vary:  # relative to the suite's own camera
            camera["elevation"] = camera["elevation"] - np.mean(distribution.elevation)
        contexts = camera | {"material_rgb": self._draw_materials(rng, n, "colour" in vary)}
        seeds = rng.integers(2**31, size=n) if "initial" in vary else np.zeros(n, np.int64)
        drawn = [self._draw_episode(int(seed)) for seed in seeds]
        return contexts | {name: np.stack([episode[name] for episode in drawn]) for name in drawn[0]}

    def _draw_materials(self, rng: np.random.Generator, n: int, vary: bool) -> np.ndarray:
        """Draw colors (n, nmat, 3) of the materials. Materials named after a target keep theirs."""
        rgb = np.repeat(self.model.mat_rgba[None, :, :3], n, axis=0).astype(np.float64)
        names = [self.model.mat(k).name for k in range(self.model.nmat)]
        targets = [k for k, name in enumerate(names) if "target" in name]
        target = rgb[:, targets[0]] if targets else RED
        for k in range(self.model.nmat):
            drawn = draw_colours(rng, n, target, gap=COLOUR_GAP)
            if vary and k not in targets:
                rgb[:, k] = drawn
        return rgb

    def _draw_episode(self, seed: int) -> Contexts:
        """The state and model fields that the suite's task draws for an episode."""
        physics, task = self._env.physics, self._env.task
        task._random = np.random.RandomState(seed)
        for name, values in self._pristine.items():
            getattr(physics.model, name)[:] = values
        with physics.reset_context():
            task.initialize_episode(physics)
        return {
            "initial_qpos": np.array(physics.data.qpos),
            "initial_qvel": np.array(physics.data.qvel),
            **{name: np.array(getattr(physics.model, name)) for name in self._pristine},
        }

    @cached_property
    def _pristine(self) -> dict[str, np.ndarray]:
        return {name: np.array(getattr(self.model, name)) for name in DRAWN_FIELDS}

    def model_fields(self, contexts: Contexts) -> dict[str, np.ndarray]:
        n = len(contexts["azimuth"])
        position, frame = self._camera
        turn = _rotation(np.array([0.0, 0.0, 1.0]), np.radians(contexts["azimuth"]))
        # The elevation changes about the camera's own right axis.
        turn = turn @ _rotation(frame[:, 0], np.radians(contexts["elevation"]))
        arm = contexts["camera_distance"][:, None] * (position - self._pivot)
        positions = self._pivot + np.einsum("nij,nj->ni", turn, arm)
        frames = turn @ frame
        fields = {name: np.array(contexts[name]) for name in DRAWN_FIELDS}
        rgba = np.repeat(self.model.mat_rgba[None], n, axis=0)
        rgba[..., :3] = contexts["material_rgb"]
        fields["mat_rgba"] = rgba
        if self._follows:
            poscom = np.repeat(self.model.cam_poscom0[None], n, axis=0)
            matrices = np.repeat(self.model.cam_mat0[None], n, axis=0)
            poscom[:, CAMERA], matrices[:, CAMERA] = positions, frames.reshape(n, 9)
            return fields | {"cam_poscom0": poscom, "cam_mat0": matrices}
        from scipy.spatial.transform import Rotation

        places = np.repeat(self.model.cam_pos[None], n, axis=0)
        quaternions = np.repeat(self.model.cam_quat[None], n, axis=0)
        places[:, CAMERA] = positions
        quaternions[:, CAMERA] = Rotation.from_matrix(frames).as_quat()[:, [3, 0, 1, 2]]
        return fields | {"cam_pos": places, "cam_quat": quaternions}

    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        return np.array(contexts["initial_qpos"]), np.array(contexts["initial_qvel"])

    def draw_states(self, rng: np.random.Generator, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        """Draw the context's own initial state with small noise on every hinge and slide, within its range."""
        qpos, qvel = self.context_state(contexts)
        for joint in range(self.model.njnt):
            if self.model.jnt_type[joint] < 2:  # free and ball joints
                continue
            k = self.model.jnt_qposadr[joint]
            noisy = qpos[:, k] + rng.uniform(-JOINT_NOISE, JOINT_NOISE, len(qpos))
            low, high = self.model.jnt_range[joint] if self.model.jnt_limited[joint] else (-np.inf, np.inf)
            qpos[:, k] = np.clip(noisy, low, high)
        return qpos, qvel

    def observe(self, state: State) -> np.ndarray:
        phase = (state.time / self.horizon)[:, None]
        return np.concatenate([state.qpos, state.qvel, phase], axis=1).astype(np.float32)

    def observe_expert(self, state: State, contexts: Contexts) -> np.ndarray:
        """The suite's own observation, flattened."""
        return self._evaluate(state, contexts)[0]

    def expert_reward(self, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        """The suite's own reward."""
        return self._evaluate(state, contexts)[1]

    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """Distance (n,), defined as 1 - reward."""
        return 1.0 - self._evaluate(state, contexts)[1]

    def outcome(self, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Initial distance 1, and final distance 1 - return / 1000."""
        return np.ones(len(distance)), distance[:, 1:].mean(axis=1) if distance.shape[1] > 1 else distance[:, 0]

    def _evaluate(self, state: State, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        """The suite's observations (n, D) and rewards (n,), cached until another state is requested."""
        if self._seen is not None and self._seen[0] is state and self._seen[1] is contexts:
            return self._seen[2], self._seen[3]
        physics, task = self._env.physics, self._env.task
        observations, rewards = [], []
        for k in range(len(state.qpos)):
            for name in DRAWN_FIELDS:
                getattr(physics.model, name)[:] = contexts[name][k]
            data: Any = physics.data
            data.qpos[:], data.qvel[:], data.ctrl[:], data.time = (
                state.qpos[k],
                state.qvel[k],
                state.ctrl[k],
                state.time[k],
            )
            physics.forward()
            observation = task.get_observation(physics)
            observations.append(np.concatenate([np.ravel(value) for value in observation.values()]))
            rewards.append(task.get_reward(physics))
        self._seen = state, contexts, np.asarray(observations, np.float32), np.asarray(rewards, np.float64)
        return self._seen[2], self._seen[3]


def _rotation(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotations (n, 3, 3) about a unit vector (3,)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(angle[:, None] * axis).as_matrix()
