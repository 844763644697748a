"""Films a demonstrator in a Gymnasium environment, each episode in its own context: another seed and viewpoint."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
from collections.abc import Generator, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from artifacts import ArtifactError, PlatformError
from stages.config.stages import DemosConfig
from stages.environments.attempts import FEWEST_ATTEMPTS, MAX_ATTEMPTS
from stages.environments.demonstrators import load_demonstrator
from stages.environments.making import EnvironmentFault, fault, frame_of, make_environment, rendered
from stages.environments.spec import EnvironmentSpec
from stages.environments.success import Success
from stages.environments.viewpoints import Viewpoint
from stages.runtime.progress import Bar
from stages.runtime.seeding import generator


@dataclass(frozen=True)
class Context:
    """The context of one episode: the seed of its `reset`, and its viewpoint relative to the environment's camera."""

    seed: int
    viewpoint: Viewpoint


@dataclass(frozen=True)
class Filmed:
    """One episode of the demonstrator.

    Attributes:
        frames: Frames (T, H, W, 3), uint8.
        env_return: Return of the environment's own reward.
        success: Whether the environment reports success; None: it reports nothing.
    """

    frames: np.ndarray
    env_return: float
    success: bool | None


class Studio:
    """An environment with its demonstrator, in one process."""

    def __init__(self, spec: EnvironmentSpec, demonstrator: str):
        """Make both.

        Raises:
            EnvironmentFault: The environment or the demonstrator cannot be made.
        """
        self._spec, self._name = spec, demonstrator
        self._demonstrator = load_demonstrator(demonstrator)
        self._success = Success()
        self.env: gymnasium.Env = make_environment(replace(spec, viewpoint=Viewpoint()), raw=True)
        self.can_move: bool = self.env.get_wrapper_attr("can_move")

    def film(self, context: Context) -> Filmed:
        """Film one episode.

        Raises:
            EnvironmentFault: The code of the environment or of the demonstrator fails.
        """
        env, spec, timing = self.env, self._spec, self._spec.timing
        if self.can_move:
            env.get_wrapper_attr("look_from")(context.viewpoint)
        where, total, ended = "reset", 0.0, False
        self._success.reset()
        try:
            observation, _ = env.reset(seed=context.seed)
            where = "the demonstrator"
            self._demonstrator.begin()
            where = "render"
            frames = [frame_of(rendered(env, spec), spec)]
            for step in range(1, spec.control_steps + 1):
                if not ended:
                    where = "the demonstrator"
                    action = _clipped(self._demonstrator.act(observation), env)
                    where = "step"
                    observation, reward, terminated, truncated, info = env.step(action)
                    total, ended = total + float(reward), terminated or truncated
                    self._success.see(info)
                if timing.frame_at(step) is not None:
                    where = "render"
                    frames.append(frame_of(rendered(env, spec), spec))
        except (Exception, SystemExit) as error:
            if where == "the demonstrator":
                where = f"demonstrator {self._name}"
            raise EnvironmentFault(fault(spec, env, where, error)) from error
        return Filmed(np.stack(frames), total, self._success.value)

    def close(self) -> None:
        """Close the environment."""
        self.env.close()


def _clipped(action: Any, env: gymnasium.Env) -> Any:
    space: Any = env.action_space
    if not isinstance(space, spaces.Box):
        return action
    given = np.asarray(action, space.dtype)
    if given.size != np.prod(space.shape) or not np.isfinite(given).all():
        raise ValueError(f"its action is {repr(action)[:80]}, expected {space}")
    return np.clip(given.reshape(space.shape), space.low, space.high)


_studio: Studio | None = None
_fault = ""


def _open(spec: EnvironmentSpec, demonstrator: str) -> None:
    global _studio, _fault
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent process, which ends this one.
    os.environ.setdefault("LP_NUM_THREADS", "1")
    try:
        _studio = Studio(spec, demonstrator)
    except EnvironmentFault as error:
        _fault = str(error)


def _film(context: Context) -> Filmed | str:
    """The episode, or what went wrong."""
    if _studio is None:
        return _fault
    try:
        return _studio.film(context)
    except EnvironmentFault as error:
        return str(error)


def film_all(
    spec: EnvironmentSpec, demonstrator: str, contexts: Iterator[Context], workers: int
) -> Generator[tuple[Context, Filmed], None, None]:
    """Film one episode per context, in order, in `workers` processes, until the caller stops.

    Raises:
        EnvironmentFault: The code of the environment or of the demonstrator fails.
        PlatformError: A process ended.
    """
    if workers == 1:
        with closing(Studio(spec, demonstrator)) as studio:
            for context in contexts:
                yield context, studio.film(context)
        return
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _open, (spec, demonstrator))
    waiting: list[tuple[Context, Any]] = []
    try:
        for context in itertools.islice(contexts, 2 * workers):
            waiting.append((context, pool.submit(_film, context)))
        while waiting:
            context, asked = waiting.pop(0)
            for following in itertools.islice(contexts, 1):
                waiting.append((following, pool.submit(_film, following)))
            filmed = asked.result()
            if isinstance(filmed, str):
                raise EnvironmentFault(filmed)
            yield context, filmed
    except BrokenProcessPool as error:
        raise PlatformError(
            f"environment {spec.name}: one of its processes ended: try --workers 1 to see why"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def draw_contexts(seed: int, middle: Viewpoint, ranges: Viewpoint | None) -> Iterator[Context]:
    """Draw the contexts of demonstrations without end: seeds, and viewpoints within `ranges` to either side.

    Args:
        seed: Seed of the draw.
        middle: Middle of the viewpoints.
        ranges: Largest change of azimuth and elevation, degrees, and of the distance, as a fraction; None: all
            viewpoints are the middle.
    """
    for index in itertools.count():
        rng = generator(seed, "environment-context", index)
        azimuth, elevation, distance = map(float, rng.uniform(-1, 1, 3) * np.array(ranges or (0.0, 0.0, 0.0)))
        viewpoint = Viewpoint(middle.azimuth + azimuth, middle.elevation + elevation, middle.distance * (1 + distance))
        yield Context(int(rng.integers(2**31)), viewpoint)


def film_successes(
    spec: EnvironmentSpec,
    demonstrator: str,
    contexts: Iterator[Context],
    config: DemosConfig,
    workers: int,
    bar: Bar,
) -> tuple[list[tuple[Context, Filmed]], int]:
    """Film until `config.n` demonstrations are kept; failures are dropped unless `config.keep_failures`.

    Returns:
        The demonstrations with their contexts, and the number of those that were dropped.

    Raises:
        ArtifactError: The demonstrator fails too often.
        EnvironmentFault, PlatformError: As `film_all`.
    """
    chosen: list[tuple[Context, Filmed]] = []
    dropped = 0
    with closing(film_all(spec, demonstrator, contexts, workers)) as filming:
        for context, filmed in filming:
            if config.keep_failures or filmed.success is not False:
                chosen.append((context, filmed))
            else:
                dropped += 1
            bar.update(len(chosen), dropped=dropped)
            if len(chosen) == config.n:
                break
            attempts = len(chosen) + dropped
            if attempts >= FEWEST_ATTEMPTS and attempts >= MAX_ATTEMPTS * max(len(chosen), 1):
                raise ArtifactError(
                    f"{demonstrator}: the demonstrator failed in {dropped} of {attempts} episodes of {spec.name}; at "
                    "least a quarter must succeed: use a better one, or keep failures (--keep-failures)"
                )
    return chosen, dropped
