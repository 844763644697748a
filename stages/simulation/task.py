"""What a task is: one definition, written for arrays of simulations, that the batch, dm_control and Gymnasium share."""

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
        qpos: Joint positions (n, nq), radians for hinges, metres for slides.
        qvel: Joint velocities (n, nv), radians or metres per second.
        site_xpos: World positions of the model's sites (n, nsite, 3), metres.
        time: Time since the start of the episode (n,), seconds.
        ctrl: The action that led to this state (n, nu); zeros at the start.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    site_xpos: np.ndarray
    time: np.ndarray
    ctrl: np.ndarray


class Task(ABC):
    """A manipulation task, defined once for the batch, dm_control and Gymnasium.

    Attributes:
        name: The task's name on the command line.
        factors: What can vary between contexts; by default only `default_factors` do.
        frame_size: Height and width of a frame, pixels, in multiples of 4.
        control_steps: Control steps per episode.
        substeps: Physics steps per control step.
        frame_every: Control steps between two frames.
        success_threshold: A run succeeds below this normalized final distance (the paper's criterion).
        expert_threshold: A demonstration is kept below this normalized final distance.
        ramp: Weight of the reward over time in the paper's experiments: `none` or `quadratic`.
        truncates: Whether the episode is cut off at the last control step, so that values extend beyond it.
        camera: Name or id of the camera that contexts place.
        oversampling: Frames are rendered this many times as high and wide, and averaged over blocks, as real footage
            is when it is reduced. 1 is faster, and sufficient where no demonstration is real.
        defaults: Options for which the task needs other values than the presets: preset -> stage -> field -> value,
            such as {"quick": {"collect-demos": {"n": 512}}}. A learner or network in place of a field holds the fields
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
        """Frames per video, T: one at every `frame_every`-th control step, the first at the start."""
        return -(-self.control_steps // self.frame_every)

    @abstractmethod
    def build(self) -> mjcf.RootElement:
        """The MJCF model."""

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model. Shared: copy before writing to it."""
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
        """Indices into qpos of the joints that motors drive; their final spread shows how consistent an expert is.

        If motors drive no joint directly (but tendons, say), the indices of all slides and hinges.
        """
        driven = self.model.actuator_trnid[self.model.actuator_trntype == 0, 0]  # 0: a joint
        single = self.model.jnt_type >= 2  # slides and hinges
        chosen = driven[single[driven]] if single[driven].any() else np.flatnonzero(single)
        return np.unique(self.model.jnt_qposadr[chosen])

    def varied(self, distribution: ContextDistribution) -> frozenset[str]:
        """The factors that are drawn from `distribution`.

        Raises:
            UsageError: The distribution varies a factor that this task lacks, or an azimuth without a range.
        """
        if distribution.vary is None:
            return frozenset(self.default_factors)
        if unknown := sorted(distribution.vary - set(self.factors)):
            raise UsageError(f"--vary {unknown[0]}: expected factors that {self.name} has, {', '.join(self.factors)}")
        if "azimuth" in distribution.vary and distribution.azimuth[0] == distribution.azimuth[1]:
            raise UsageError("--vary azimuth: expected --contexts paper or narrow, which say how far; fixed has one")
        return distribution.vary

    @abstractmethod
    def draw_contexts(self, rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
        """Draw `n` contexts."""

    @abstractmethod
    def model_fields(self, contexts: Contexts) -> dict[str, np.ndarray]:
        """The MjModel fields that make `contexts` visible: name -> (n, *shape of the field)."""

    @abstractmethod
    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        """The initial state in each context's first frame o_0: qpos (n, nq), qvel (n, nv)."""

    @abstractmethod
    def draw_states(self, rng: np.random.Generator, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        """Draw an episode's initial state in each context: qpos (n, nq), qvel (n, nv)."""

    @abstractmethod
    def observe(self, state: State) -> np.ndarray:
        """Observation (n, D) of the learner's policy: never the goal.

        --learner gps reads the control step from its last entry, time / horizon.
        """

    @abstractmethod
    def observe_expert(self, state: State, contexts: Contexts) -> np.ndarray:
        """Observation (n, D) of the expert: the state, the time and the goal."""

    @abstractmethod
    def expert_reward(self, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        """Hand-written reward (n,) for reaching `state` by `action` (n, nu)."""

    @abstractmethod
    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """Distance (n,) of the task's object from its goal, metres: not negative, and above 0 at the start.

        For household tasks with many pieces, the share of pieces not at the goal yet; for dm_control's, 1 - reward.
        """

    def goal_error(self, state: State, contexts: Contexts) -> np.ndarray:
        """The task's error as a vector (n, m), zero once the task is done, for learners with quadratic costs.

        The squared norm of its first part is the squared distance in metres; for tasks that count pieces, the mean
        squared distance of the pieces. Errors of intermediate steps may follow.

        Raises:
            UsageError: The task does not define it.
        """
        raise UsageError(
            f"task {self.name} does not define goal_error, the error as a vector, which --learner gps needs beside "
            "--reward oracle; use --learner trpo"
        )

    @property
    def demonstrator(self) -> Task | None:
        """The same task with the body of the scripted demonstrator that `plan` moves; None: an expert is trained."""
        return None

    def plan(self, contexts: Contexts, rng: np.random.Generator | None = None) -> np.ndarray:
        """Actions (control steps, n, nu) of the demonstrator; `rng` adds natural variation."""
        raise NotImplementedError(f"{self.name} has no plan")

    def kinesthetic(self, contexts: Contexts) -> np.ndarray:
        """Joint positions (T, nq) of the robot guided by hand through the task in one context; zeros for the rest."""
        raise NotImplementedError(f"{self.name} has no plan")

    def outcome(self, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Initial and final distance (n,) of episodes, from the distances (n, control steps + 1)."""
        return distance[:, 0], distance[:, -1]
