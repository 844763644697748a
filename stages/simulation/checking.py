"""Checks that a task implements `stages.simulation.task.Task` correctly, like Stable-Baselines3's check_env.

`ifo check-task` checks a user's task, and the tests check the built-in ones. The guard (`stages.simulation.guard`)
detects wrong shapes and exceptions; this module runs the task and compares results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from artifacts.errors import UsageError
from stages.simulation.batch import BatchSimulation
from stages.simulation.blame import TaskError
from stages.simulation.contexts import DISTRIBUTIONS, FACTORS, take
from stages.simulation.guard import attribute_faults, guarded
from stages.simulation.probe import SHOWN, SIMULATIONS, Episode, Probe
from stages.simulation.task import State, Task

Promise = Callable[[Probe], Iterator[TaskError]]

FOUNDATIONS = ("attributes", "model")  # if these fail, nothing else can be checked
LOOKS = 5  # contexts compared per factor
CAMERA_FACTORS = ("azimuth", "elevation", "distance")
ROUNDING = 1e-4  # tolerated relative difference in results between a small and a large batch


@dataclass(frozen=True)
class Report:
    """Result of a check.

    Attributes:
        problems: The faults with their locations, one line each; empty if there are none.
        promises: Names of the checks that were run.
        frames: First frames (20, H, W, 3) of contexts, uint8; None if the task could not be rendered.
    """

    problems: tuple[str, ...]
    promises: tuple[str, ...]
    frames: np.ndarray | None


def check_task(task: Task, seed: int = 0) -> Report:
    """Run all checks on a task. It renders frames: choose a GL backend first.

    Raises:
        PlatformError: Rendering does not work on this machine.
    """
    probe = Probe(guarded(task), seed)
    problems: list[str] = []
    checked: list[str] = []
    try:
        for name, promise in PROMISES.items():
            problems += _problems(promise, probe)
            checked.append(name)
            if problems and name in FOUNDATIONS:
                break
        frames = vars(probe).get("frames")
    finally:
        probe.close()
    return Report(tuple(dict.fromkeys(problems)), tuple(checked), frames)  # One fault can fail several checks.


def _problems(promise: Promise, probe: Probe) -> list[str]:
    problems = []
    try:
        for error in promise(probe):
            problems.append(error.problem)
    except TaskError as error:
        problems.append(error.problem)
    return problems


def attributes(probe: Probe) -> Iterator[TaskError]:
    """Step counts, sizes, thresholds and factors are valid."""
    yield from attribute_faults(probe.task)


def model(probe: Probe) -> Iterator[TaskError]:
    """The model compiles, has the camera and actuators, and accepts actions in [-1, 1]."""
    compiled = probe.task.model
    for k in range(compiled.nu):
        low, high = compiled.actuator_ctrlrange[k]
        if compiled.actuator_ctrllimited[k] and (low, high) != (-1, 1):
            named = compiled.actuator(k).name or k
            yield probe.broken(
                "build", f"limits actuator {named} to [{low:g}, {high:g}], expected [-1, 1]: scale it with gear"
            )
    probe.task.posture  # noqa: B018 - the guard checks it


def contexts_follow_from_the_seed(probe: Probe) -> Iterator[TaskError]:
    """The same seed draws the same contexts, and a different seed draws different ones."""
    for name in DISTRIBUTIONS:
        one, other, again = probe.draw(LOOKS, name), probe.draw(LOOKS, name, seed=1), probe.draw(LOOKS, name)
        if unlike := _differing(one, again):
            yield probe.broken(
                "draw_contexts", f"drew different values of {unlike[0]!r} under the same seed: draw only from `rng`"
            )
        if name == "paper" and probe.task.default_factors and not _differing(one, other):
            yield probe.broken("draw_contexts", "drew the same contexts under different seeds: draw from `rng`")
    probe.draw(1)


def factors_vary(probe: Probe) -> Iterator[TaskError]:
    """A factor changes the images or the initial states if and only if it is selected."""
    task = probe.task
    for factor in (factor for factor in FACTORS if factor not in task.factors):
        try:
            probe.draw(1, vary=factor)
        except TaskError:
            raise
        except UsageError:
            continue
        yield probe.broken(
            "draw_contexts", f"accepts --vary {factor}, which is not in `factors`: call self.varied(distribution) first"
        )
    for name, factor in (("fixed", ""), *(("paper", factor) for factor in task.factors)):
        contexts = probe.draw(LOOKS, name, vary=factor)
        moved = any(_vary(part) for part in task.context_state(contexts))
        seen = _vary(probe.looks(contexts))
        if not factor and (moved or seen):
            yield probe.broken("draw_contexts", "varies what --contexts fixed keeps: use self.varied(distribution)")
        if factor and not (moved or seen):
            yield probe.broken("draw_contexts", f"draws contexts that look identical under --vary {factor}")
        if factor in CAMERA_FACTORS and moved:
            yield probe.broken("context_state", f"changes under --vary {factor}, which must move only the camera")


def states_are_drawn(probe: Probe) -> Iterator[TaskError]:
    """Initial states are determined by the seed, and vary within a context."""
    task, contexts = probe.task, probe.contexts
    if _unequal(task.context_state(contexts), task.context_state(contexts)):
        yield probe.broken("context_state", "returned a different state the second time")
    again = task.draw_states(probe.rng("start"), contexts)
    if _unequal(probe.start, again):
        yield probe.broken("draw_states", "drew a different state under the same seed: draw only from `rng`")
    if not _unequal(probe.start, task.draw_states(probe.rng("other"), contexts)):
        yield probe.broken("draw_states", "drew the same states under different seeds: add noise to the initial state")


def nothing_is_overwritten(probe: Probe) -> Iterator[TaskError]:
    """Results do not share memory with earlier results, and arguments are not modified."""
    task, contexts = probe.task, probe.contexts
    simulation = BatchSimulation(task, SIMULATIONS)
    first = simulation.reset(*probe.start)
    second = simulation.step(np.zeros_like(first.ctrl))
    methods: dict[str, Callable[[State], np.ndarray]] = {
        "observe": task.observe,
        "observe_expert": lambda state: task.observe_expert(state, contexts),
        "expert_reward": lambda state: task.expert_reward(state, state.ctrl, contexts),
        "distance": lambda state: task.distance(state, contexts),
    }
    for name, method in methods.items():
        given = {**vars(first), **contexts}
        before = {key: np.array(values) for key, values in given.items()}
        one, other = method(first), method(second)
        if np.shares_memory(one, other):
            yield probe.broken(name, "returned the same memory twice: return a new array each time")
        if changed := _differing(before, given):
            yield probe.broken(name, f"modified {changed[0]} of its argument: work on a copy")


def episodes_are_reproducible(probe: Probe) -> Iterator[TaskError]:
    """An episode is reproducible, stable, and independent of the other simulations in the batch."""
    one, again = probe.episode, probe.play()
    expected = np.arange(one.time.shape[1]) * probe.task.control_timestep
    if not np.isfinite(one.qpos).all() or not np.allclose(one.time, expected):
        yield probe.broken("build", "gives physics that diverge under random actions: reduce timestep or forces")
        return
    for name in _said_differently(one, again, exact=True):
        yield probe.broken(name, "differs when the same episode is repeated: it must depend only on its arguments")
    for k in (0, SIMULATIONS - 1):
        alone, here = probe.play(slice(k, k + 1)), slice(k, k + 1)
        for name in _said_differently(alone, one, here):
            yield probe.broken(
                name, f"of simulation {k} depends on others in the batch: do not mix rows; reduce over axis=1"
            )


def distances_start_above_zero(probe: Probe) -> Iterator[TaskError]:
    """Distances start above zero in each of 20 contexts, and doing nothing is not a success."""
    task, contexts = probe.task, probe.draw(SHOWN)
    for method in (lambda: task.context_state(contexts), lambda: task.draw_states(probe.rng("distance"), contexts)):
        task.outcome(task.distance(BatchSimulation(task, SHOWN).reset(*method()), contexts)[:, None])
    idle = probe.roll(task, lambda state, where: np.zeros_like(state.ctrl)).normalised_distance.mean()
    if idle < task.success_threshold:
        yield probe.broken(
            "success_threshold",
            f"is {task.success_threshold:g}, but a robot that does nothing ends at {idle:.2f} of the initial distance",
        )


def frames_show_the_task(probe: Probe) -> Iterator[TaskError]:
    """Frames are not blank, contexts look different, and motion is visible."""
    task, frames = probe.task, probe.frames
    if blank := [k for k, frame in enumerate(frames) if not _vary(frame.reshape(-1, 3))]:
        yield probe.broken("model_fields", f"renders one flat color in context {blank[0]}: does its camera see it?")
        return
    if task.default_factors and not _vary(frames):
        yield probe.broken("model_fields", "renders the same frame in all contexts")
    ends, fields = probe.episode.qpos[:, [0, -1]], task.model_fields(probe.contexts)
    start, end = (
        probe.pool.render(fields, ends[:, k : k + 1]) for k in (0, 1)
    )  # the same tiles, so the frames are equal if nothing moved
    if np.array_equal(start, end):
        yield probe.broken("model_fields", "renders no motion: the frame after random actions equals the first frame")


def goal_error_is_a_vector(probe: Probe) -> Iterator[TaskError]:
    """If there is an error vector for guided policy search, the observation contains the time."""
    if not probe.has_goal_error:
        return
    episode = probe.episode
    if not np.allclose(episode.observe[..., -1], episode.time / probe.task.horizon, atol=1e-4):
        yield probe.broken(
            "observe", "does not end with time / horizon, from which --learner gps reads the control step"
        )


def demonstrator_demonstrates(probe: Probe) -> Iterator[TaskError]:
    """A scripted demonstrator makes videos of the same format as the robot, and its plan solves the task."""
    task, person = probe.task, probe.task.demonstrator
    if person is None:
        return
    for name in ("frame_size", "control_steps", "frame_every", "control_timestep"):
        if getattr(person, name) != getattr(task, name):
            yield probe.broken("demonstrator", f"has a different {name} than the robot, expected {getattr(task, name)}")
            return
    plan = person.plan(probe.contexts)
    if not np.array_equal(plan, person.plan(probe.contexts)):
        yield probe.broken("plan", "differs the second time: without `rng` it must depend only on the contexts")
    if np.abs(plan).max() > 1:
        yield probe.broken("plan", f"contains actions up to {np.abs(plan).max():.3g}, expected [-1, 1]")
    given = iter(plan)
    left = probe.roll(person, lambda state, where: next(given)).normalised_distance
    if (good := float((left < task.expert_threshold).mean())) < 0.25:
        yield probe.broken(
            "plan", f"succeeds in {good:.0%} of contexts, expected at least 25% to end below expert_threshold"
        )
    person.plan(probe.contexts, probe.rng("plan"))
    task.kinesthetic(take(probe.contexts, slice(0, 1)))


PROMISES: dict[str, Promise] = {
    "attributes": attributes,
    "model": model,
    "contexts": contexts_follow_from_the_seed,
    "factors": factors_vary,
    "states": states_are_drawn,
    "memory": nothing_is_overwritten,
    "episodes": episodes_are_reproducible,
    "distances": distances_start_above_zero,
    "frames": frames_show_the_task,
    "goal_error": goal_error_is_a_vector,
    "demonstrator": demonstrator_demonstrates,
}


def _vary(values: np.ndarray) -> bool:
    """Whether the entries along the first axis differ."""
    return bool((values != values[:1]).any())


def _differing(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> list[str]:
    """Names whose arrays differ."""
    return [name for name in {**one, **other} if not np.array_equal(one.get(name, ()), other.get(name, ()))]


def _unequal(one: tuple[np.ndarray, ...], other: tuple[np.ndarray, ...]) -> bool:
    return not all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def _said_differently(one: Episode, other: Episode, of: slice = slice(None), exact: bool = False) -> Iterator[str]:
    """Yield the names of task results that differ between an episode and the simulations `of` another episode."""
    for name in ("observe", "observe_expert", "expert_reward", "distance", "goal_error"):
        a, b = getattr(one, name), getattr(other, name)[of]
        if not (np.array_equal(a, b) if exact else np.allclose(a, b, ROUNDING, 1e-6)):
            yield name
