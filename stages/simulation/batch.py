"""Runs many simulations of one task on a thread pool (mujoco.batch)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stages.simulation.contexts import Contexts
from stages.simulation.task import State, Task

HELD = 5  # control steps for which `held` repeats an action


class BatchSimulation:
    """`nsim` simulations of a task in lockstep: all episodes start and end at the same control step.

    Results do not depend on `nthread`, because each simulation is stepped by a single thread.
    """

    def __init__(self, task: Task, nsim: int, nthread: int = 0):
        import mujoco
        import mujoco.batch

        self._stage = mujoco.mjtStage.mjSTAGE_POS
        self.task = task
        self.nsim = nsim
        self._batch = mujoco.batch.Batch(task.model, nsim, nthread=nthread)
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._time, self._ctrl = self._batch.bind("time"), self._batch.bind("ctrl")
        self._sites = self._batch.bind("site_xpos")

    def reset(self, qpos: np.ndarray, qvel: np.ndarray) -> State:
        """Start all episodes at qpos (nsim, nq) and qvel (nsim, nv)."""
        import mujoco

        self._batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        self._qpos[:], self._qvel[:], self._ctrl[:] = qpos, qvel, 0.0
        self._batch.forward(stage=self._stage)
        return self.state()

    def step(self, action: np.ndarray) -> State:
        """Apply `action` (nsim, nu), clipped to [-1, 1], for one control step."""
        self._ctrl[:] = np.clip(action, -1.0, 1.0)
        self._batch.step(nstep=self.task.substeps, stage=self._stage)
        return self.state()

    def state(self) -> State:
        """The current state; its arrays are copies."""
        return State(
            qpos=self._qpos.copy(),
            qvel=self._qvel.copy(),
            site_xpos=self._sites.reshape(self.nsim, self.task.model.nsite, 3).copy(),
            time=self._time.reshape(self.nsim).copy(),
            ctrl=self._ctrl.copy(),
        )


@dataclass(frozen=True)
class Rollout:
    """Episodes of n simulations.

    Attributes:
        qpos: Joint positions (n, control_steps + 1, nq).
        distance: `Task.distance` to the goal at every control step (n, control_steps + 1).
        initial_distance: Distance at the start (n,).
        final_distance: Distance at the end (n,).
    """

    qpos: np.ndarray
    distance: np.ndarray
    initial_distance: np.ndarray
    final_distance: np.ndarray

    @property
    def normalised_distance(self) -> np.ndarray:
        """Final divided by initial distance (n,), the paper's metric."""
        return self.final_distance / self.initial_distance

    def frame_qpos(self, task: Task) -> np.ndarray:
        """Joint positions (n, T, nq) at the control steps that a video shows: every `frame_every`-th, starting at 0."""
        return self.qpos[:, : task.control_steps : task.frame_every]


def rollout(
    task: Task,
    contexts: Contexts,
    qpos: np.ndarray,
    qvel: np.ndarray,
    act: Callable[[State, Contexts], np.ndarray],
    nthread: int = 0,
) -> Rollout:
    """Roll out a policy for one episode in each of n contexts.

    Args:
        act: Maps (state, contexts) to actions (n, nu).

    Returns:
        The rollout, with the state at every control step.
    """
    simulation = BatchSimulation(task, len(qpos), nthread)
    state = simulation.reset(qpos, qvel)
    positions, distances = [state.qpos], [task.distance(state, contexts)]
    for _ in range(task.control_steps):
        state = simulation.step(act(state, contexts))
        positions.append(state.qpos)
        distances.append(task.distance(state, contexts))
    distance = np.stack(distances, axis=1)
    return Rollout(np.stack(positions, axis=1), distance, *task.outcome(distance))


def held(values: np.ndarray, task: Task) -> Callable[[State, Contexts], np.ndarray]:
    """A policy that plays back the actions `values` (K, n, nu), holding each for 5 control steps.

    Noise that is redrawn at every step would average out before it moves the robot.
    """

    def act(state: State, contexts: Contexts) -> np.ndarray:
        step = round(float(state.time[0]) / task.control_timestep)
        return values[min(step // HELD, len(values) - 1)]

    return act


def drawn_actions(rng: np.random.Generator, task: Task, n: int) -> np.ndarray:
    """Draw uniform random actions (K, n, nu) for n episodes with `held`."""
    return rng.uniform(-1.0, 1.0, (-(-task.control_steps // HELD), n, task.action_size))
