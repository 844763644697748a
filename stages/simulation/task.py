"""The task interface: one vectorized definition that the batch simulation, dm_control and Gymnasium share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from artifacts.errors import UsageError
from stages.config.tasks.entry import TaskDefaults
from stages.simulation.contexts import ContextDistribution, Contexts

if TYPE_CHECKING:
    import mujoco
    from dm_control import mjcf


@dataclass(frozen=True)
class State:
    """State of `n` simulations.

    Attributes:
        qpos: Joint positions (n, nq), radians for hinges, meters for slides.
        qvel: Joint velocities (n, nv), radians or meters per second.
        site_xpos: World positions of the model's sites (n, nsite, 3), meters.
        time: Time since the start of the episode (n,), seconds.
        ctrl: Action that led to this state (n, nu); zeros at the start.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    site_xpos: np.ndarray
    time: np.ndarray
    ctrl: np.ndarray


class Task(ABC):
    """A manipulation task, defined once for the batch simulation, dm_control and Gymnasium.

    Attributes:
        name: The task's name on the command line.
        factors: Factors that can vary between contexts. By default only `default_factors` vary.
        frame_size: Height and width of a frame, pixels, in multiples of 4.
        control_steps: Control steps per episode.
        substeps: Physics steps per control step.
        frame_every: Control steps between two frames.
        success_threshold: A run succeeds below this normalized final distance (the paper's criterion).
        expert_threshold: A demonstration is kept below this normalized final distance.
        ramp: Weighting of the reward over time in the paper's experiments: `none` or `quadratic`.
        truncates: Whether episodes are truncated at the last control step, so that values bootstrap beyond it.
        camera: Name or id of the camera that contexts place.
        oversampling: Frames are rendered this many times larger along each side and averaged over blocks, like real
            footage that is scaled down. 1 is faster, and sufficient if no demonstration is real.
        defaults: The task's own defaults where they differ from the presets: preset -> stage -> field -> value, for
            example {"quick": {"collect-demos": {"n": 512}}}. A learner or network instead of a field contains fields
            that apply only with it: {"quick": {"learn-policy": {"gps": {"blur": 8.0}}}}.
    """

    name: str
    factors: tuple[str, ...] = ("azimuth", "elevation", "distance", "initial")
    default_factors: tuple[str, ...] = ("azimuth", "initial")
    frame_size: tuple[int, int] = (48, 48)
    control_steps: int = 50
    substeps: int = 5
    frame_every: int = 2
    success_threshold: float = 0.5
    expert_threshold: float = 0.3
    ramp: str = "none"
    truncates: bool = False
    camera: str | int = "context"
    oversampling: int = 1
    defaults: TaskDefaults = MappingProxyType({})

    @property
    def frames(self) -> int:
        """Frames per video, T: one every `frame_every` control steps, starting at the initial state."""
        return -(-self.control_steps // self.frame_every)

    @abstractmethod
    def build(self) -> mjcf.RootElement:
        """Build the MJCF model."""

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model. It is shared: copy it before modifying it."""
        import mujoco
        from dm_control import mjcf

        root = self.build()
        if not isinstance(root, mjcf.RootElement):
            raise TypeError(f"build returned a {type(root).__name__}, expected a dm_control.mjcf.RootElement")
        return mujoco.MjModel.from_xml_string(root.to_xml_string(), root.get_assets())

    @property
    def control_timestep(self) -> float:
        """Seconds per control step."""
        return float(self.model.opt.timestep) * self.substeps

    @property
    def horizon(self) -> float:
        """Seconds per episode."""
        return self.control_timestep * self.control_steps

    @property
    def action_size(self) -> int:
        return int(self.model.nu)

    @property
    def posture(self) -> np.ndarray:
        """Indices into qpos of the actuated joints. Their final spread measures the consistency of an expert.

        If no joint is actuated directly (only tendons, for example), the indices of all slides and hinges.
        """
        driven = self.model.actuator_trnid[self.model.actuator_trntype == 0, 0]  # 0: a joint
        single = self.model.jnt_type >= 2  # slides and hinges
        chosen = driven[single[driven]] if single[driven].any() else np.flatnonzero(single)
        return np.unique(self.model.jnt_qposadr[chosen])

    def varied(self, distribution: ContextDistribution) -> frozenset[str]:
        """The factors that vary under `distribution`.

        Raises:
            UsageError: The distribution varies a factor that the task does not have, or an azimuth without a range.
        """
        if distribution.vary is None:
            return frozenset(self.default_factors)
        if unknown := sorted(distribution.vary - set(self.factors)):
            raise UsageError(f"--vary {unknown[0]}: expected factors of {self.name}: {', '.join(self.factors)}")
        if "azimuth" in distribution.vary and distribution.azimuth[0] == distribution.azimuth[1]:
            raise UsageError("--vary azimuth: needs --contexts paper or narrow; fixed has a single azimuth")
        return distribution.vary

    @abstractmethod
    def draw_contexts(self, rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
        """Draw `n` contexts."""

    @abstractmethod
    def model_fields(self, contexts: Contexts) -> dict[str, np.ndarray]:
        """MjModel fields that render `contexts`: name -> (n, *shape of the field)."""

    @abstractmethod
    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        """Initial state shown in each context's first frame o_0: qpos (n, nq), qvel (n, nv)."""

    @abstractmethod
    def draw_states(self, rng: np.random.Generator, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        """Draw the initial state of one episode per context: qpos (n, nq), qvel (n, nv)."""

    @abstractmethod
    def observe(self, state: State) -> np.ndarray:
        """Observation (n, D) of the learner's policy. It never contains the goal.

        --learner gps reads the control step from its last entry, time / horizon.
        """

    @abstractmethod
    def observe_expert(self, state: State, contexts: Contexts) -> np.ndarray:
        """Observation (n, D) of the expert, with the state, the time and the goal."""

    @abstractmethod
    def expert_reward(self, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        """Hand-written reward (n,) for reaching `state` by `action` (n, nu)."""

    @abstractmethod
    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """Distance (n,) of the task's object from its goal, meters: non-negative, and positive at the start.

        For household tasks with many pieces, the fraction of pieces not at the goal; for dm_control tasks, 1 - reward.
        """

    def goal_error(self, state: State, contexts: Contexts) -> np.ndarray:
        """The task's error as a vector (n, m), zero once the task is done, for learners with quadratic costs.

        The squared norm of its first part is the squared distance in meters; for tasks that count pieces, the mean
        squared distance of the pieces. Errors of intermediate goals may follow.

        Raises:
            UsageError: The task does not define goal_error.
        """
        raise UsageError(
            f"task {self.name} does not define goal_error, the error vector that --learner gps needs with "
            "--reward oracle; use --learner trpo"
        )

    @property
    def demonstrator(self) -> Task | None:
        """The same task with the scripted demonstrator's body, driven by `plan`; None if an expert is trained."""
        return None

    def plan(self, contexts: Contexts, rng: np.random.Generator | None = None) -> np.ndarray:
        """Actions (control steps, n, nu) of the scripted demonstrator; `rng` adds natural variation."""
        raise NotImplementedError(f"{self.name} has no plan")

    def kinesthetic(self, contexts: Contexts) -> np.ndarray:
        """Joint positions (T, nq) of a kinesthetic demonstration in one context; zeros for the objects' joints."""
        raise NotImplementedError(f"{self.name} has no plan")

    def outcome(self, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Initial and final distance (n,) of episodes, from the distances (n, control steps + 1)."""
        return distance[:, 0], distance[:, -1]
