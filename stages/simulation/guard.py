"""The boundary between ifo and a user's own task: return values are checked, and exceptions are reported.

Built-in tasks need no guard: their faults are bugs in ifo, and the tests apply the same checks to them
(`stages.simulation.checking`).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from numbers import Integral
from typing import TYPE_CHECKING, Any, NoReturn, cast

import numpy as np

from artifacts.errors import IfoError
from stages.config.stages import FRAME_SIDES, RAMPS
from stages.config.values import checked_defaults
from stages.simulation.blame import TaskError, broken, definition, failure, modules_of
from stages.simulation.contexts import FACTORS, ContextDistribution, Contexts
from stages.simulation.task import State, Task

if TYPE_CHECKING:
    import mujoco

COUNTS = ("control_steps", "substeps", "frame_every", "oversampling")
SHARES = ("success_threshold", "expert_threshold")
PROTOCOL = {name for name in (*vars(Task), *Task.__annotations__) if not name.startswith("_")}

Shape = tuple[int | str, ...]  # a letter stands for any size that stays the same in every call


def guarded(task: Task) -> Task:
    """Wrap the task in a guard, which passes for the task itself. A guarded task is returned unchanged."""
    return cast(Task, task if type(task) is Guard else Guard(task))


def attribute_faults(task: Task) -> Iterator[TaskError]:
    """Yield the faults in the plain attributes of a user's task."""
    guard: Any = guarded(task)
    for name in COUNTS:
        if not _is_count(value := getattr(guard, name)):
            yield broken(task, name, f"is {value!r}, expected an integer of at least 1")
    for name in SHARES:
        if not isinstance(value := getattr(guard, name), int | float) or not 0 < value <= 1:
            yield broken(task, name, f"is {value!r}, expected a fraction of the initial distance in (0, 1]")
    size, sides = guard.frame_size, FRAME_SIDES
    if not isinstance(size, tuple) or len(size) != 2 or not all(side in sides for side in size):
        yield broken(
            task,
            "frame_size",
            f"is {size!r}, expected height and width in multiples of {sides.step} from {sides[0]} to {sides[-1]}",
        )
    try:
        checked_defaults(guard.defaults)
    except ValueError as error:
        yield broken(task, "defaults", str(error))
    if guard.ramp not in (ramps := RAMPS[1:]):
        yield broken(task, "ramp", f"is {guard.ramp!r}, expected one of {', '.join(ramps)}")
    known: tuple[str, ...] = FACTORS
    for name in ("factors", "default_factors"):
        if not isinstance(value := getattr(guard, name), tuple) or not all(factor in known for factor in value):
            yield broken(task, name, f"is {value!r}, expected a tuple with elements from {', '.join(known)}")
        else:
            known = value
    if _is_count(guard.control_steps) and _is_count(guard.frame_every) and guard.control_steps <= guard.frame_every:
        yield broken(task, "frame_every", f"is {guard.frame_every}, which gives one frame per video: expected less")


class Guard:
    """Stand-in for a user's task with the same attributes and methods; `isinstance` works as for the task.

    Raises:
        TaskError: The task raised an exception or returned a value that `Task` does not allow.
    """

    def __init__(self, task: Task):
        vars(self).update(_task=task, _sizes={}, _model=None)

    @property  # type: ignore[misc]
    def __class__(self) -> type:
        return type(self._task)

    def __getattr__(self, name: str) -> Any:
        if name not in PROTOCOL:
            return getattr(self._task, name)
        with self._reporting(name):
            return getattr(self._task, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._task, name, value)

    @property
    def model(self) -> mujoco.MjModel:
        if self._model is None:
            vars(self)["_model"] = self._checked_model()
        return self._model

    @property
    def demonstrator(self) -> Task | None:
        with self._reporting("demonstrator"):
            found = self._task.demonstrator
        if found is None:
            return None
        if not isinstance(found, Task):
            self._refuse("demonstrator", f"is a {type(found).__name__}, expected a Task or None")
        if not getattr(found, "name", ""):
            found.name = self._task.name
        return guarded(found)

    @property
    def posture(self) -> np.ndarray:
        with self._reporting("posture"):
            indices = self._task.posture
        if not isinstance(indices, np.ndarray) or indices.ndim != 1 or indices.dtype.kind not in "iu":
            self._refuse("posture", "is not an integer array (k,) of indices into qpos")
        if not len(indices):
            self._refuse("posture", "is empty because the model has no hinge or slide: override it")
        if indices.min() < 0 or indices.max() >= self.model.nq:
            self._refuse("posture", f"contains indices outside the model's {self.model.nq} joint positions")
        return indices

    def draw_contexts(self, rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
        contexts = self._call("draw_contexts", rng, n, distribution)
        self._check_dict("draw_contexts", contexts)
        if not contexts:
            self._refuse("draw_contexts", "returned an empty dict, expected at least one array")
        for name, values in contexts.items():
            if "/" in name:
                self._refuse("draw_contexts", f"returned the name {name!r}, expected one without '/'")
            shape = np.shape(values)
            self._check("draw_contexts", values, (n, *shape[1:]), f"[{name!r}]")
        return contexts

    def model_fields(self, contexts: Contexts) -> dict[str, np.ndarray]:
        fields = self._call("model_fields", contexts)
        self._check_dict("model_fields", fields)
        for name, values in fields.items():
            own = getattr(self.model, name, None)
            if not isinstance(own, np.ndarray):
                self._refuse("model_fields", f"returned {name!r}, expected array fields of mujoco.MjModel")
            self._check("model_fields", values, (_count(contexts), *own.shape), f"[{name!r}]")
        return fields

    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        return self._check_start("context_state", self._call("context_state", contexts), _count(contexts))

    def draw_states(self, rng: np.random.Generator, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        return self._check_start("draw_states", self._call("draw_states", rng, contexts), _count(contexts))

    def observe(self, state: State) -> np.ndarray:
        return self._check("observe", self._call("observe", state), (len(state.qpos), "D"))

    def observe_expert(self, state: State, contexts: Contexts) -> np.ndarray:
        return self._check("observe_expert", self._call("observe_expert", state, contexts), (len(state.qpos), "D"))

    def expert_reward(self, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        value = self._call("expert_reward", state, action, contexts)
        return self._check("expert_reward", value, (len(state.qpos),))

    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        value = self._check("distance", self._call("distance", state, contexts), (len(state.qpos),))
        if value.min() < 0:
            self._refuse("distance", f"returned {value.min():g}, expected a non-negative distance")
        return value

    def goal_error(self, state: State, contexts: Contexts) -> np.ndarray:
        return self._check("goal_error", self._call("goal_error", state, contexts), (len(state.qpos), "m"))

    def plan(self, contexts: Contexts, rng: np.random.Generator | None = None) -> np.ndarray:
        shape = (self._task.control_steps, _count(contexts), self.action_size)
        return self._check("plan", self._call("plan", contexts, rng), shape)

    def kinesthetic(self, contexts: Contexts) -> np.ndarray:
        return self._check("kinesthetic", self._call("kinesthetic", contexts), (self._task.frames, self.model.nq))

    def outcome(self, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        both = self._call("outcome", distance)
        if not isinstance(both, tuple) or len(both) != 2:
            self._refuse("outcome", "did not return a pair of initial and final distances")
        for part, value in zip(("initial", "final"), both, strict=True):
            self._check("outcome", value, (len(distance),), f", {part} distance,")
        if both[0].min() <= 0:
            self._refuse(
                "outcome" if "outcome" in vars(self.__class__) else "distance",
                "starts an episode at distance 0, expected more: results are divided by the initial distance",
            )
        return both

    def _checked_model(self) -> mujoco.MjModel:
        import mujoco

        with self._reporting("build"):
            model = self._task.model
        if not isinstance(model, mujoco.MjModel):
            self._refuse("model", f"is a {type(model).__name__}, expected a mujoco.MjModel")
        camera = self._task.camera
        names = [model.camera(k).name for k in range(model.ncam)]
        there = camera in names if isinstance(camera, str) else camera in range(model.ncam)
        if not there:
            found = ", ".join(name or str(k) for k, name in enumerate(names)) or "none"
            self._refuse("build", f"has no camera {camera!r}, which renders the frames; its cameras: {found}")
        if not model.nu:
            self._refuse("build", "has no actuator: expected at least one")
        return model

    def _check_start(self, method: str, start: Any, n: int) -> tuple[np.ndarray, np.ndarray]:
        if not isinstance(start, tuple) or len(start) != 2:
            self._refuse(method, f"returned a {type(start).__name__}, expected a pair qpos (n, nq), qvel (n, nv)")
        self._check(method, start[0], (n, self.model.nq), ", qpos,")
        self._check(method, start[1], (n, self.model.nv), ", qvel,")
        return start

    def _check_dict(self, method: str, value: Any) -> None:
        if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
            self._refuse(method, f"returned a {type(value).__name__}, expected a dict of named arrays")

    def _check(self, method: str, value: Any, shape: Shape, which: str = "") -> np.ndarray:
        """Return `value` if it is an array of finite numbers with this shape, or raise TaskError."""
        told = f"{which} returned".lstrip() if which.startswith(",") else f"returned{which}"
        known = tuple(self._sizes.get((method, k), size) for k, size in enumerate(shape))
        expected = f"({', '.join(map(str, known))}{',' if len(known) == 1 else ''})"
        if not isinstance(value, np.ndarray):
            self._refuse(method, f"{told} a {type(value).__name__}, expected an array {expected}")
        if not _fits(value.shape, known):
            self._refuse(method, f"{told} an array {value.shape}, expected {expected}")
        if value.dtype.kind not in "biuf":
            self._refuse(method, f"{told} an array of {value.dtype}, expected numbers")
        if not np.isfinite(value).all():
            bad = int(np.count_nonzero(~np.isfinite(value)))
            self._refuse(method, f"{told} {bad} non-finite numbers of {value.size}")
        for k, letter in enumerate(shape):
            if isinstance(letter, str):
                self._sizes[method, k] = value.shape[k]
        return value

    def _call(self, method: str, *arguments: Any) -> Any:
        try:
            return getattr(self._task, method)(*arguments)
        except IfoError:
            raise
        except Exception as error:  # User code may fail in any way, and no failure of it is a bug in ifo.
            raise self._failed(method, error) from error

    @contextmanager
    def _reporting(self, name: str) -> Iterator[None]:
        """Report errors like `_call`, for properties."""
        try:
            yield
        except (IfoError, AttributeError) as error:
            if isinstance(error, IfoError) or not hasattr(type(self._task), name):
                raise
            raise self._failed(name, error) from error
        except Exception as error:
            raise self._failed(name, error) from error

    def _failed(self, name: str, error: Exception) -> TaskError:
        kind = type(self._task)
        told = failure(error, modules_of(kind), definition(kind, name))
        return TaskError(self._task.name, f"{name} failed {told}")

    def _refuse(self, name: str, problem: str) -> NoReturn:
        raise broken(self._task, name, problem)


def _count(contexts: Contexts) -> int:
    return len(next(iter(contexts.values())))


def _is_count(value: Any) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 1


def _fits(shape: tuple[int, ...], expected: Shape) -> bool:
    return len(shape) == len(expected) and all(
        (isinstance(e, str) and s > 0) or s == e for s, e in zip(shape, expected, strict=True)
    )
