"""`check_task` finds each broken promise, says where, and says it once."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from stages.simulation.checking import PROMISES, check_task
from stages.simulation.registry import make_task

pytestmark = pytest.mark.gl
EXAMPLES = Path(__file__).parents[2] / "examples"
sys.path.append(str(EXAMPLES))
from glide import Glide  # noqa: E402

from stages.simulation.tasks.household_push import PushReal  # noqa: E402


class Example(Glide):
    name = "example"


class BadNumbers(Example):
    frame_every = 0
    success_threshold = 2.0
    frame_size = (50, 50)
    ramp = "linear"


class WideActions(Example):
    def build(self):
        root = super().build()
        root.find("actuator", "x").ctrlrange = (-2, 2)
        return root


class OwnGenerator(Example):
    def draw_contexts(self, rng, n, distribution):
        return super().draw_contexts(np.random.default_rng(), n, distribution)


class SameContexts(Example):
    def draw_contexts(self, rng, n, distribution):
        return super().draw_contexts(np.random.default_rng(0), n, distribution)


class IgnoresVary(Example):
    def varied(self, distribution):
        return frozenset(self.default_factors)


class FactorWithoutEffect(Example):
    factors = (*Glide.factors, "colour")


class CameraMovesTheDisc(Example):
    def context_state(self, contexts):
        qpos, qvel = super().context_state(contexts)
        return qpos + 0.001 * contexts["azimuth"][:, None], qvel


class SameStart(Example):
    def draw_states(self, rng, contexts):
        return self.context_state(contexts)


class StartOfItsOwn(Example):
    def draw_states(self, rng, contexts):
        return super().draw_states(np.random.default_rng(), contexts)


class OneBuffer(Example):
    def observe(self, state):
        seen = super().observe(state)
        if not hasattr(self, "buffer") or self.buffer.shape != seen.shape:
            self.buffer = np.empty_like(seen)
        self.buffer[:] = seen
        return self.buffer


class Overwrites(Example):
    def distance(self, state, contexts):
        state.qpos[:] -= contexts["goal"]
        return np.linalg.norm(state.qpos, axis=1)


class LooksAside(Example):
    def expert_reward(self, state, action, contexts):
        return super().expert_reward(state, action, contexts) - state.qpos.mean()


class Counts(Example):
    calls = 0

    def observe_expert(self, state, contexts):
        self.calls += 1
        return super().observe_expert(state, contexts) + np.float32(self.calls)


class Explodes(Example):
    def build(self):
        root = super().build()
        root.option.timestep = 0.5
        for joint in root.find_all("joint"):
            joint.stiffness = 1e6
        return root


class Idle(Example):
    def outcome(self, distance):
        return distance[:, 0], 0.1 * distance[:, -1]


class LooksAway(Example):
    def model_fields(self, contexts):
        return super().model_fields(contexts | {"camera_distance": -contexts["camera_distance"]})


class Invisible(Example):
    def build(self):
        root = super().build()
        root.find("geom", "disc").rgba = (0, 0, 0, 0)
        return root


class NoClock(Example):
    def observe(self, state):
        return np.concatenate([state.qpos, state.qvel], axis=1).astype(np.float32)

    def goal_error(self, state, contexts):
        return state.qpos - contexts["goal"]


class Clumsy(PushReal):
    name = "clumsy"

    def plan(self, contexts, rng=None):
        return np.full_like(super().plan(contexts, rng), 1.5)


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        (WideActions, "build (PLACE) limits actuator x to [-2, 2], expected [-1, 1]"),
        (OwnGenerator, "draw_contexts (PLACE) drew different values of 'azimuth' under the same seed"),
        (SameContexts, "draw_contexts (PLACE) drew the same contexts under different seeds"),
        (IgnoresVary, "draw_contexts (GLIDE) varies what --contexts fixed keeps"),
        (FactorWithoutEffect, "draw_contexts (GLIDE) draws contexts that look identical under --vary colour"),
        (CameraMovesTheDisc, "context_state (PLACE) changes under --vary azimuth"),
        (SameStart, "draw_states (PLACE) drew the same states under different seeds"),
        (StartOfItsOwn, "draw_states (PLACE) drew a different state under the same seed"),
        (OneBuffer, "observe (PLACE) returned the same memory twice"),
        (Overwrites, "distance (PLACE) modified qpos of its argument"),
        (LooksAside, "expert_reward (PLACE) of simulation 0 depends on others in the batch"),
        (Counts, "observe_expert (PLACE) differs when the same episode is repeated"),
        (Explodes, "build (PLACE) gives physics that diverge"),
        (Idle, "success_threshold (CLASS) is 0.5, but a robot that does nothing ends at 0.10"),
        (LooksAway, "model_fields (PLACE) renders one flat color in context 0"),
        (Invisible, "model_fields (GLIDE) renders no motion"),
        (NoClock, "observe (PLACE) does not end with time / horizon"),
        (Clumsy, "plan (PLACE) contains actions up to 1.5"),
        (Clumsy, "plan (PLACE) succeeds in 0% of contexts"),
    ],
)
def test_a_broken_promise_is_found_and_its_place_told(monkeypatch, kind, told):
    monkeypatch.chdir(Path(__file__).parent)
    problems = check_task(kind()).problems
    beginning, _, end = told.partition(" (")
    place, _, end = end.partition(")")
    (found,) = (problem for problem in problems if problem.startswith(beginning) and end in problem)
    file, _, line = found.removeprefix(f"{beginning} (").partition(")")[0].rpartition(":")
    if place == "GLIDE":
        assert file == str(EXAMPLES / "glide.py")
    else:
        assert file == Path(__file__).name
        shown = Path(__file__).read_text(encoding="utf-8").splitlines()[int(line) - 1]
        assert shown.strip().startswith("class " + kind.__name__ if place == "CLASS" else "def " + beginning)


def test_a_task_without_faults_has_no_problem():
    report = check_task(Example())
    assert report.problems == ()
    assert set(report.promises) == set(PROMISES)
    assert len(np.unique(report.frames, axis=0)) == 20


def test_all_bad_attributes_are_told():
    names = [problem.split()[0] for problem in check_task(BadNumbers()).problems]
    assert names == ["frame_every", "success_threshold", "frame_size", "ramp"]


def test_what_breaks_everything_is_told_once():
    class NoModel(Example):
        def build(self):
            return None

    report = check_task(NoModel())
    (problem,) = report.problems
    assert problem.startswith("build failed at ") and "build returned a NoneType" in problem
    assert report.frames is None


def test_the_seed_decides_what_is_drawn():
    one, same, other = (check_task(make_task("reach"), seed).frames for seed in (0, 0, 1))
    assert np.array_equal(one, same) and not np.array_equal(one, other)
