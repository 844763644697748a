"""How policies are judged: by the distance to a simulated task's goal, or by what a Gymnasium environment reports."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from typing import Any, Protocol

import numpy as np
import torch

from artifacts import Artifact, ArtifactError
from stages.environments.foreign import ForeignEnvironment
from stages.environments.making import code_digest as environment_digest
from stages.environments.playing import Act, play
from stages.environments.spec import EnvironmentSpec
from stages.learners.policy import Policy, check_fits, first_observation
from stages.reporting.figures import figures, means
from stages.reporting.films import film_environment, film_task
from stages.reporting.plots import LABELS
from stages.rewards.own import OwnReward
from stages.runtime.seeding import generator, integer
from stages.simulation.batch import rollout
from stages.simulation.contexts import Contexts, repeat
from stages.simulation.recorded import recorded_contexts
from stages.simulation.registry import code_digest, make_task
from stages.simulation.task import Task

OUTCOMES = ("success", "env_return")  # of an episode in a Gymnasium environment
DISTANCE = "normalised_distance"


class Judge(Protocol):
    """Judges policies of one task or environment.

    Attributes:
        recipe: Digests of code that decides the result.
        about: What the evaluation records of the task or environment.
    """

    recipe: dict[str, str]
    about: dict[str, Any]

    def episodes(self, source: Artifact, episodes: int, seed: int, index: int) -> dict[str, np.ndarray]:
        """Outcomes (E,) of `episodes` episodes of the policy number `index`, deterministic and stochastic."""
        ...

    def video(self, source: Artifact, index: int) -> np.ndarray:
        """Pictures (T, H', W', 3) of one deterministic episode, with captions."""
        ...

    def figures(self, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
        """Means and intervals over all policies, of outcomes (R, E)."""
        ...

    def verdict(self, summary: dict[str, Any], runs: int) -> str:
        """One line for people."""
        ...

    def curve(self, sources: Sequence[Artifact]) -> tuple[str, str, float | None]:
        """The learning curve to plot, the label of its axis, and the value below which a run succeeds, if any."""
        ...


class Simulated:
    """Judges by the distance to the goal, which policies never observe."""

    def __init__(self, name: str):
        self._task = make_task(name)
        self._observation = first_observation(self._task)
        self.recipe = code_digest(self._task)
        self.about: dict[str, Any] = {"task": self._task.name, "success_threshold": self._task.success_threshold}

    def episodes(self, source: Artifact, episodes: int, seed: int, index: int) -> dict[str, np.ndarray]:
        check_fits(source, self._task, self._observation)
        contexts = recorded_contexts(source, self._task)
        return simulated_episodes(self._task, Policy.load(source), contexts, episodes, seed, index)

    def video(self, source: Artifact, index: int) -> np.ndarray:
        return film_task(self._task, Policy.load(source), recorded_contexts(source, self._task))

    def figures(self, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
        threshold = self._task.success_threshold
        return figures(arrays["normalised_distance"], arrays["normalised_distance_stochastic"], threshold)

    def verdict(self, summary: dict[str, Any], runs: int) -> str:
        low, high = summary["success_paper_interval"]
        return (
            f"normalized final distance {summary['normalised_distance_stochastic']:.3f} (stochastic policy; "
            f"deterministic {summary['normalised_distance']:.3f}); {summary['succeeded']} of {runs} runs succeed "
            f"by the paper's criterion (95% interval {low:.2f} to {high:.2f}), and "
            f"{summary['success_deterministic']:.0%} of the deterministic episodes"
        )

    def curve(self, sources: Sequence[Artifact]) -> tuple[str, str, float | None]:
        return DISTANCE, LABELS[DISTANCE], self._task.success_threshold


def simulated_episodes(
    task: Task, policy: Any, contexts: Contexts, episodes: int, seed: int, index: int
) -> dict[str, np.ndarray]:
    """Distances (E,) of `episodes` deterministic episodes, and of stochastic ones from the same initial states."""
    same = repeat(contexts, episodes)
    qpos, qvel = task.draw_states(generator(seed, "evaluate", index), same)
    noise = torch.Generator().manual_seed(integer(seed, "evaluate-noise", index))
    calm = rollout(task, same, qpos, qvel, lambda state, _: policy.act(task.observe(state)), 1)
    noisy = rollout(task, same, qpos, qvel, lambda state, _: policy.act(task.observe(state), noise), 1)
    return {
        "initial_distance": calm.initial_distance,
        "final_distance": calm.final_distance,
        "normalised_distance": calm.normalised_distance,
        "final_distance_stochastic": noisy.final_distance,
        "normalised_distance_stochastic": noisy.normalised_distance,
    }


class Foreign:
    """Judges by the success that a Gymnasium environment reports, and by its own return."""

    def __init__(self, specs: Sequence[EnvironmentSpec | None], processes: int):
        self._specs = [spec for spec in specs if spec is not None]
        self._processes = processes
        first = self._specs[0]
        self.recipe = environment_digest(first.name, first.success) | {"processes": str(processes)}
        self.about: dict[str, Any] = {"task": None, "environment": first.described(), "processes": processes}

    def episodes(self, source: Artifact, episodes: int, seed: int, index: int) -> dict[str, np.ndarray]:
        policy, noise = Policy.load(source), torch.Generator().manual_seed(integer(seed, "evaluate-noise", index))
        processes = self._processes
        found: dict[str, np.ndarray] = {}
        with closing(ForeignEnvironment(self._specs[index], processes, 1, OwnReward(), range(0))) as env:
            _check_fits(source, env)
            ways: dict[str, Act] = {"": policy.act, "_stochastic": lambda seen: policy.act(seen, noise)}
            for suffix, act in ways.items():
                for _ in range(episodes // processes):
                    play(env, act, frames=False)
                for name, values in env.pop_outcomes().items():
                    found[f"{name}{suffix}"] = values
        return found

    def video(self, source: Artifact, index: int) -> np.ndarray:
        return film_environment(self._specs[index], Policy.load(source))

    def figures(self, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
        return means({name: arrays[name] for name in sorted(arrays) if name.partition("_stoch")[0] in OUTCOMES})

    def verdict(self, summary: dict[str, Any], runs: int) -> str:
        parts = []
        if "success" in summary:
            low, high = summary["success_stochastic_interval"]
            parts.append(
                f"{summary['success_stochastic']:.0%} of the stochastic policy's episodes succeed (95% interval "
                f"{low:.2f} to {high:.2f}; deterministic {summary['success']:.0%})"
            )
        parts.append(
            f"return of the environment's own reward {summary['env_return_stochastic']:.2f} (deterministic "
            f"{summary['env_return']:.2f})"
        )
        return "; ".join(parts) + ("" if runs == 1 else f"; {runs} runs")

    def curve(self, sources: Sequence[Artifact]) -> tuple[str, str, float | None]:
        name = "success" if all("curve/success" in source for source in sources) else "env_return"
        return name, LABELS[name], None


def _check_fits(source: Artifact, env: ForeignEnvironment) -> None:
    found = source.config["observation_size"], source.config["action_size"]
    if found != (env.observation_size, env.action_size):
        raise ArtifactError(
            f"{source.path}: a policy from {found[0]} observations to {found[1]} actions does not fit environment "
            f"{env.name}, which has {env.observation_size} and {env.action_size}: learn it again"
        )
