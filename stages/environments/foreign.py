"""Any Gymnasium environment as an environment to learn in, in several processes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from artifacts import PlatformError
from stages.environments.lockstep import make_lockstep
from stages.environments.making import EnvironmentFault
from stages.environments.protocol import Environment
from stages.environments.spec import EnvironmentSpec

if TYPE_CHECKING:
    from stages.learners.reward import Reward


PATIENCE = 2.0  # seconds that a process gets to end


@dataclass(frozen=True)
class ForeignMoment:
    """What n environments show after the same control step.

    Attributes:
        step: Control steps since the start of the episode.
        observation: Observations (n, D), float32.
        own_reward: The environments' own rewards (n,) of this step.
        shown: Frames (n, H, W, 3), uint8; None: this step has no frame.
    """

    step: int
    observation: np.ndarray
    own_reward: np.ndarray
    shown: np.ndarray | None = None

    def frames(self) -> np.ndarray:
        if self.shown is None:
            raise ValueError(f"step {self.step} has no frame")
        return self.shown


class ForeignEnvironment(Environment):
    """Copies of a Gymnasium environment in lockstep, one per process; all episodes have the same context."""

    moment: ForeignMoment
    last: ForeignMoment

    def __init__(self, spec: EnvironmentSpec, processes: int, rounds: int, reward: Reward, shown: range | None = None):
        """Start the processes.

        Args:
            spec: The environment.
            processes: Number of environments, each in its own process; 1: in this process.
            rounds: Episodes of each environment per iteration of a learner.
            reward: What the learner is paid.
            shown: Indices of the frames to take; None: all.

        Raises:
            EnvironmentFault: The environment's code fails.
            PlatformError: A process ended.
        """
        self._spec = spec
        self._venv = _processes(partial(make_lockstep, spec, shown), processes)
        self._next: np.ndarray | None = None
        self._outcomes: list[dict[str, np.ndarray]] = []
        self._ended: list[dict[str, float]] = []
        try:
            size = self._venv.action_space.shape
            assert size is not None
            super().__init__(spec.name, processes, spec.timing, reward, size[0], rounds)
        except BaseException:
            _end(self._venv)
            raise

    def begin(self) -> ForeignMoment:
        observed, self._next = self._next, None
        if observed is None:  # Otherwise, the environments have already started the episode.
            observed = self._asked(self._venv.reset)
        infos = self._venv.reset_infos
        self._check(infos)
        return ForeignMoment(0, observed, np.zeros(len(observed), np.float32), _frames(infos))

    def advance(self, actions: np.ndarray) -> ForeignMoment:
        clipped = np.clip(actions, -1.0, 1.0).astype(np.float32)
        observed, rewards, done, infos = self._asked(lambda: self._venv.step(clipped))
        self._check(infos)
        if done[0]:
            self._next = observed
            observed = np.stack([info["terminal_observation"] for info in infos])
            self._ended = [info["outcome"] for info in infos]
        return ForeignMoment(self.moment.step + 1, observed, rewards, _frames(infos))

    def record(self) -> None:
        names = set.intersection(*(set(outcome) for outcome in self._ended))
        self._outcomes.append({name: np.array([outcome[name] for outcome in self._ended]) for name in sorted(names)})

    def pop_outcomes(self) -> dict[str, np.ndarray]:
        """Outcomes (m,) of all episodes that ended since the last call: `env_return`, and `success` if it is known."""
        ended, self._outcomes = self._outcomes, []
        names = set.intersection(*map(set, ended)) if ended else set()
        return {name: np.concatenate([each[name] for each in ended]) for name in sorted(names)}

    def pop_figures(self) -> dict[str, float]:
        return {name: float(values.mean()) for name, values in self.pop_outcomes().items()}

    def _asked(self, call: Callable[[], Any]) -> Any:
        try:
            return call()
        except (EOFError, BrokenPipeError, ConnectionResetError) as error:
            raise PlatformError(
                f"environment {self._spec.name}: one of its processes ended: try --workers 1 to see why"
            ) from error

    def _check(self, infos: Any) -> None:
        for info in infos:
            if "fault" in info:
                raise EnvironmentFault(info["fault"])

    def close(self) -> None:
        super().close()
        _end(self._venv)


def processes_for(episodes: int, workers: int) -> int:
    """The largest number of processes, at most `workers`, among which `episodes` can be divided evenly."""
    return max(count for count in range(1, min(workers, episodes) + 1) if episodes % count == 0)


def _processes(make: Callable[[], Any], count: int) -> VecEnv:
    if count == 1:
        return DummyVecEnv([make])
    try:
        return SubprocVecEnv([make] * count, start_method="spawn")
    except (EOFError, BrokenPipeError, ConnectionResetError) as error:
        raise PlatformError("a process of the environment ended as it started: try --workers 1 to see why") from error


def _end(venv: VecEnv) -> None:
    """End the processes, whatever they are doing; `SubprocVecEnv.close` would wait for those that are gone."""
    if not isinstance(venv, SubprocVecEnv):
        venv.close()
        return
    for remote in venv.remotes:
        with suppress(OSError):
            remote.send(("close", None))
    for process in venv.processes:
        process.join(PATIENCE)
        if process.is_alive():
            process.terminate()
            process.join(PATIENCE)
        if process.is_alive():
            process.kill()
    for remote in venv.remotes:
        remote.close()
    venv.closed = True


def _frames(infos: Any) -> np.ndarray | None:
    """The frames (n, H, W, 3) that infos hold; None: none."""
    return np.stack([info["frame"] for info in infos]) if all("frame" in info for info in infos) else None
