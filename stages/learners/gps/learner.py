"""Guided policy search as a learner beside those of Stable-Baselines3: rollouts, updates, and what is kept of them.

The controller acts on the state x that the paper gives it (Sec. V.B): the robot's own observation without the clock,
and what the reward tracks, such as image features. What is learned in the end is to run where nothing is tracked: so
beside it stands the best approximation, on the robot's own observation alone, of the controller that made the last
rollouts: the conditional distribution of its actions given that observation, around the rollouts' means, with the
spread in closed form under the fitted dynamics. That one is what a policy artifact holds and what is evaluated; the
curve shows rollouts of the controller itself. The update behind the last rollouts would be one that nobody has tried.

A search is a local one: what its first rollouts happen upon decides where it ends. Several may begin apart, then, take
turns, and the cheapest goes on alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from artifacts import UsageError
from stages.config.stages import TRACKED_REWARDS, LearnerConfig, PolicyConfig
from stages.learners.environment import EpisodeEnv
from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.gmm import Mixture
from stages.learners.gps.gps import Improvement, Search, iterate
from stages.learners.gps.lqr import QuadraticCost, on_part
from stages.learners.reward import TrackingReward
from stages.runtime.seeding import generator
from stages.simulation.task import State, Task

MOST_STEPS = 200  # control steps an episode: over many more, errors of the dynamics add up to nonsense
# R of a cost of actions 1/2 R |u|^2, over what standing still costs a control step, of the target tracked first.
# Linear dynamics know of no limits to the motors: where actions cost little, updates ask for a hundred times what there
# is, and learn little from it.
ACTION_COST = 0.2
# Log of the least standard deviation of actions, if the first one is not less, falling to none in the last iteration:
# an update that sees no way to move an object leaves hardly any noise, and then none is found; and the bound on the KL
# divergence lets a controller move little farther than its noise goes.
EXPLORATION = -1.2
REFINED = 1 / 3  # of the iterations, after which what is finer is tracked, once one search is left
APART = 1 / 2  # of the iterations, at most, in which several searches take turns


@dataclass(frozen=True)
class Start:
    """One search, and what it has come to.

    Attributes:
        search: Where it stands.
        own: The controller on the robot's own observation, of its last rollouts.
        next: That of its next ones, as far as they can be foretold.
        cost: Mean of its last rollouts'; infinite before the first.
    """

    search: Search
    own: LinearGaussianController
    next: LinearGaussianController
    cost: float = math.inf

    def state(self) -> dict[str, Any]:
        """All of it, as a tree of arrays and numbers."""
        search = self.search
        return {
            "controller": search.controller.arrays(),
            "own": self.own.arrays(),
            "next": self.next.arrays(),
            "cost": self.cost,
            "step": search.step,
            "states": search.states,
            "actions": search.actions,
            "mixture": {} if search.mixture is None else dict(vars(search.mixture)),
            "foretold": list(search.foretold or ()),
        }

    @classmethod
    def of(cls, state: dict[str, Any]) -> Start:
        """What `state` describes."""
        search = Search(
            controller=LinearGaussianController(**state["controller"]),
            step=state["step"],
            states=state["states"],
            actions=state["actions"],
            mixture=Mixture(**state["mixture"]) if state["mixture"] else None,
            foretold=(state["foretold"][0], state["foretold"][1]) if state["foretold"] else None,
        )
        own, following = (LinearGaussianController(**state[name]) for name in ("own", "next"))
        return cls(search, own, following, state["cost"])


class GuidedPolicySearch:
    """Learns a time-varying linear-Gaussian controller in one context.

    Attributes:
        env: Where rollouts are made; all of its simulations share one context.
        num_timesteps: Control steps taken so far, of all simulations.
        last: What the last iteration found; None before the first.
    """

    def __init__(self, config: LearnerConfig, env: EpisodeEnv, seed: int):
        """Start from actions about zero.

        Raises:
            UsageError: The reward tracks nothing, the observation has no clock, episodes are too long, or the bound is
                zero.
        """
        reward = env.reward
        if not isinstance(reward, TrackingReward):
            raise UsageError(f"--learner gps: expected --reward {', '.join(TRACKED_REWARDS)}, which track a target")
        config.check_together()
        if env.task.control_steps > MOST_STEPS:
            raise UsageError(
                f"--learner gps fits dynamics to every control step: expected at most {MOST_STEPS} an episode, "
                f"{env.task.name} has {env.task.control_steps}; use --learner trpo"
            )
        if not ends_with_clock(env.task, env.state):
            raise UsageError(
                f"--learner gps: the controller's time step is read from the clock, which the observation of "
                f"{env.task.name} does not end with; use --learner trpo"
            )
        self._reward = reward
        self._config, self._seed = config, seed
        self.env = env
        self.num_timesteps = 0
        self._size = env.observation_size - 1
        steps, tracked = env.task.control_steps, reward.targets.shape[1]
        std = float(np.exp(config.log_std))
        first = LinearGaussianController.constant(steps, self._size + tracked, env.task.action_size, std)
        own = LinearGaussianController.constant(steps, self._size, env.task.action_size, std)
        starts = config.starts if isinstance(config, PolicyConfig) else 1
        self._starts = [Start(Search(first), own, own)] * starts
        self._apart = starts * int(APART * config.iterations / starts) if starts > 1 else 0
        self._penalty = ACTION_COST * self._standing_still() * np.eye(env.task.action_size)
        self._cost = self._tracking()
        self.last: Improvement | None = None
        self._period = reward.frame_period
        self._iterations = 0
        self._refined = -1 if reward.finer is None else max(int(REFINED * config.iterations), 1, self._apart)
        self._fresh = False

    @property
    def controller(self) -> LinearGaussianController:
        """What makes the next rollouts, on the whole state."""
        return self._starts[self._turn].search.controller

    @property
    def own(self) -> LinearGaussianController:
        """The controller on the robot's own observation, of the cheapest search's last rollouts."""
        return self._cheapest().own

    @property
    def _turn(self) -> int:
        return self._iterations % len(self._starts)

    def _cheapest(self) -> Start:
        return min(self._starts, key=lambda start: start.cost)

    def learn(self, total_timesteps: int, reset_num_timesteps: bool = False) -> GuidedPolicySearch:
        """One episode of every simulation, and one update; named and called as Stable-Baselines3's.

        Raises:
            FloatingPointError: The rollouts' cost is no finite number.
        """
        if self._iterations == self._refined:
            self._refine()
        rng = generator(self._seed, "gps", self._iterations)
        states, actions = self.rollouts(rng)
        least_std = self._least_std(self._iterations + 1)
        cost = float(self._cost.of(states, actions).mean())
        if not math.isfinite(cost):
            raise FloatingPointError("what rollouts cost is no finite number")
        ran = self._starts[self._turn].search
        search, self.last = iterate(ran, states, actions, self._cost, self._config.kl, rng, least_std, self._period)
        assert self.last.seen is not None
        own = on_part(ran.controller, self.last.seen, self._size)
        following = on_part(search.controller, self.last.marginals, self._size)
        self._starts[self._turn] = Start(search, own, following, cost)
        self._iterations += 1
        if self._iterations == self._apart:
            self._starts = [self._cheapest()]
        self.num_timesteps += actions.shape[0] * actions.shape[1]
        return self

    def rollouts(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """States (N, T + 1, dx) and actions (N, T, du) of one episode of every simulation under the controller."""
        env, controller = self.env, self.controller
        if not self._fresh:
            env.reset()  # What the environment was made with is no numbered episode.
            self._fresh = True
        states, actions = [self._state(0, env.state)], []
        for step in range(controller.steps):
            noise = rng.standard_normal((env.num_envs, env.task.action_size))
            actions.append(controller.sample(step, states[-1], noise))
            _, _, done, _ = env.step(actions[-1])
            states.append(self._state(step + 1, env.final if done[0] else env.state))
        return np.stack(states, axis=1), np.stack(actions, axis=1)

    def _tracking(self) -> QuadraticCost:
        """The cost, in what the reward tracks now."""
        targets, weights = self._reward.targets, self._reward.cost_weights
        return QuadraticCost.tracking(self._size + targets.shape[1], targets, weights, self._penalty)

    def _refine(self) -> None:
        """Go on with the reward's finer target, from the next controller on the robot's own observation.

        What is known of the dynamics goes: the numbers of images are others now.
        """
        self._track_finer()
        (start,) = self._starts
        lifted = start.next.lifted(self._size + self._reward.targets.shape[1])
        self._starts = [replace(start, search=Search(lifted.widened(self._least_std(self._iterations))))]

    def _track_finer(self) -> None:
        assert self._reward.finer is not None
        self._reward = self.env.reward = self._reward.finer
        self._cost = self._tracking()

    def _least_std(self, iterations: int) -> float:
        """Of actions, after so many iterations."""
        left = max(1 - iterations / self._config.iterations, 0)
        return left * float(np.exp(min(EXPLORATION, self._config.log_std)))

    def _standing_still(self) -> float:
        """What it costs a control step to stay where the environment has just begun."""
        seen = self._reward.tracked(0, self.env.state, self.env.contexts).mean(axis=0)
        apart = np.square(self._reward.targets - seen).sum(axis=1)
        return max(float((0.5 * self._reward.cost_weights * apart).mean()), 1e-9)

    def _state(self, step: int, state: State) -> np.ndarray:
        """x (n, dx) after `step` control steps."""
        own = self.env.task.observe(state)[:, :-1].astype(np.float64)
        return np.concatenate([own, self._reward.tracked(step, state, self.env.contexts)], axis=1)

    def state(self) -> dict[str, Any]:
        """Everything that decides how learning goes on, as a tree of arrays and numbers."""
        return {
            "starts": [start.state() for start in self._starts],
            "iterations": self._iterations,
            "samples": self.num_timesteps,
            "episode": self.env.episode,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Put `state` back, bit for bit."""
        if 0 < self._refined < state["iterations"]:
            self._track_finer()
        self._starts = [Start.of(start) for start in state["starts"]]
        self._iterations, self.num_timesteps = state["iterations"], state["samples"]
        if self._iterations:
            self.env.episode = state["episode"] - 1  # The running episode was drawn before: draw it again.
            self.env.reset()
            self._fresh = True


def ends_with_clock(task: Task, state: State) -> bool:
    """Whether the learner's observation ends with the time over the episode's, and tells it nowhere else."""
    start, end = (task.observe(replace(state, time=np.full_like(state.time, t))) for t in (0.0, task.horizon))
    told = (end - start).astype(np.float64)
    return bool(np.allclose(told[:, :-1], 0, atol=1e-6) and np.allclose(told[:, -1], 1, atol=1e-5))
