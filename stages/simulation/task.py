"""What a task is: one definition, written for arrays of simulations, that every face of it shares."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from artifacts.errors import UsageError
from stages.simulation.contexts import ContextDistribution, Contexts

if TYPE_CHECKING:
    import mujoco
    from dm_control import mjcf


@dataclass(frozen=True)
class State:
    """Where `n` simulations are.

    Attributes:
        qpos: Joint positions (n, nq), radians, or metres of what slides.
        qvel: Joint velocities (n, nv), the same a second.
        site_xpos: World positions of the model's sites (n, nsite, 3), metres.
        time: Time since the episode's start (n,), seconds.
        ctrl: The action that led here (n, nu), zeros at the start.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    site_xpos: np.ndarray
    time: np.ndarray
    ctrl: np.ndarray


class Task(ABC):
    """A manipulation task, defined once for the batch, dm_control and Gymnasium.

    Attributes:
        name: What the command line calls it.
        factors: What can vary between its contexts; `default_factors` of these do unless the user says otherwise.
        frame_size: Height and width of a frame, pixels.
        control_steps: Control steps an episode.
        substeps: Physics steps a control step.
        frame_every: Control steps between two frames.
        success_threshold: Normalised final distance below which a run succeeds (the paper's criterion).
        expert_threshold: Normalised final distance below which a demonstration is kept.
        ramp: How the paper weights the reward over time in this task: `none` or `quadratic`.
        truncates: Whether the last control step merely cuts the episode off, so that values go on beyond it.
        camera: The camera that contexts place: its name or id in the model.
        oversampling: Frames are drawn so many times as high and wide, and each block's mean is a pixel. Real footage is
            reduced so; where demonstrations are none, sharp pixels do as well, and are drawn faster.
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

    @property
    def frames(self) -> int:
        """Frames a video, T: one at every `frame_every`-th control step, the first at the start."""
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
        """Seconds between two actions."""
        return float(self.model.opt.timestep) * self.substeps

    @property
    def horizon(self) -> float:
        """Seconds an episode."""
        return self.control_timestep * self.control_steps

    @property
    def action_size(self) -> int:
        return int(self.model.nu)

    @property
    def posture(self) -> np.ndarray:
        """Indices into qpos of the joints that motors drive: their final spread tells how consistent an expert is.

        Where motors drive no joint directly, as through tendons, those of all slides and hinges.
        """
        driven = self.model.actuator_trnid[self.model.actuator_trntype == 0, 0]  # 0: a joint
        single = self.model.jnt_type >= 2  # slides and hinges
        chosen = driven[single[driven]] if single[driven].any() else np.flatnonzero(single)
        return np.unique(self.model.jnt_qposadr[chosen])

    def varied(self, distribution: ContextDistribution) -> frozenset[str]:
        """The factors that are drawn from `distribution`.

        Raises:
            UsageError: It varies something that this task does not have, or an azimuth without a range.
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
        """The MjModel fields that show `contexts`: name -> (n, *shape of the field)."""

    @abstractmethod
    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        """The state that a context's first frame o_0 shows: qpos (n, nq), qvel (n, nv)."""

    @abstractmethod
    def draw_states(self, rng: np.random.Generator, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        """Draw an episode's initial state in each context: qpos (n, nq), qvel (n, nv)."""

    @abstractmethod
    def observe(self, state: State) -> np.ndarray:
        """What the learner's policy sees, (n, D): never the goal; the time, where episodes are short."""

    @abstractmethod
    def observe_expert(self, state: State, contexts: Contexts) -> np.ndarray:
        """What the expert sees, (n, D): the state, the time and the goal."""

    @abstractmethod
    def expert_reward(self, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        """Hand-written reward (n,) of arriving in `state` by `action` (n, nu)."""

    @abstractmethod
    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        """Distance (n,) of the task's object to its goal, metres.

        Of household tasks with many pieces the share of them that is not there yet; of the suite's tasks 1 - reward.
        """

    def goal_error(self, state: State, contexts: Contexts) -> np.ndarray:
        """How far from done, as a vector (n, m) that is zero once all is done: for learners of quadratic costs.

        The squared norm of its first part is the squared distance, in metres also where the task counts pieces (then
        their mean squared one); what must be done on the way may follow.

        Raises:
            UsageError: The task does not say.
        """
        raise UsageError(
            f"task {self.name} does not define goal_error, the error as a vector, which --learner gps needs beside "
            "--reward oracle; use --learner trpo"
        )

    @property
    def demonstrator(self) -> Task | None:
        """The same task with the body of somebody who demonstrates it by `plan`; None: an expert must be trained."""
        return None

    def plan(self, contexts: Contexts, rng: np.random.Generator | None = None) -> np.ndarray:
        """Actions (control steps, n, nu) by which a demonstrator does the task; with `rng`, not quite steadily."""
        raise NotImplementedError(f"{self.name} has no plan")

    def kinesthetic(self, contexts: Contexts) -> np.ndarray:
        """Joint positions (T, nq) of the robot led through the task in one context; zeros where nothing is driven."""
        raise NotImplementedError(f"{self.name} has no plan")

    def outcome(self, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What an episode is judged by: initial and final distance (n,), of the distances (n, control steps + 1)."""
        return distance[:, 0], distance[:, -1]
