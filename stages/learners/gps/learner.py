"""Guided policy search as a learner with the interface of Stable-Baselines3: rollouts, updates and the final policy.

As in the paper (Sec. V.B), the controller acts on a state x that consists of the robot's own observation without the
clock and the values that the reward tracks, for example image features. The learned policy must run without these
tracked values. Therefore the learner also computes an approximation of the controller that uses only the robot's own
observation: the conditional distribution of the actions given this observation, around the means of the rollouts, with
covariances in closed form under the fitted dynamics. Policy artifacts contain this approximation, and `evaluate` runs
it. The learning curve shows rollouts of the controller itself. The approximation is of the controller that produced the
last rollouts, because the update after them is untested.

The search is local: its result depends on its first rollouts. Several independent searches can therefore run in turn;
after half the iterations, only the one with the lowest cost continues.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from artifacts import UsageError
from stages.config.stages import TRACKED_REWARDS, LearnerConfig, PolicyConfig
from stages.environments.protocol import Environment, Moment
from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.gmm import Mixture
from stages.learners.gps.gps import Improvement, Search, iterate
from stages.learners.gps.lqr import QuadraticCost, on_part
from stages.learners.reward import TrackingReward
from stages.runtime.seeding import generator

MOST_STEPS = 200  # maximum control steps per episode: over longer episodes, errors of the dynamics accumulate
# R of the action cost 1/2 R |u|^2, relative to the cost per control step of standing still with the first target.
# Linear dynamics do not model the limits of the motors. If actions cost too little, updates ask for a hundred times the
# available torque, and rollouts are uninformative.
ACTION_COST = 0.2
# Log of the minimum standard deviation of actions, if the initial one is not lower; the minimum falls linearly to zero
# in the last iteration. Without it, an update that finds no way to move an object removes nearly all noise, and then
# later rollouts find none either. Also, the bound on the KL divergence limits changes to about the scale of the noise.
EXPLORATION = -1.2
REFINED = 1 / 3  # share of the iterations after which the finer target is tracked, once only one search is left
APART = 1 / 2  # maximum share of the iterations in which several searches run in turn


@dataclass(frozen=True)
class Start:
    """One search and its latest results.

    Attributes:
        search: State of the search.
        own: Controller on the robot's own observation that approximates the controller of the last rollouts.
        next: Controller on the robot's own observation that approximates the next controller, by predicted marginals.
        cost: Mean cost of the last rollouts; infinite before the first.
    """

    search: Search
    own: LinearGaussianController
    next: LinearGaussianController
    cost: float = math.inf

    def state(self) -> dict[str, Any]:
        """The search and its results as a tree of arrays and numbers."""
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
            "predicted": list(search.predicted or ()),
        }

    @property
    def shapes(self) -> list[tuple[int, ...]]:
        """Shapes that stay the same during the search; the state that it acts on grows with a finer target."""
        own = [array.shape for controller in (self.own, self.next) for array in controller.arrays().values()]
        return [self.search.controller.offsets.shape, *own]

    @classmethod
    def of(cls, state: dict[str, Any]) -> Start:
        """The search and results described by `state`."""
        predicted = state["predicted"] if "predicted" in state else state["foretold"]  # its name in schema 1
        search = Search(
            controller=LinearGaussianController(**state["controller"]),
            step=state["step"],
            states=state["states"],
            actions=state["actions"],
            mixture=Mixture(**state["mixture"]) if state["mixture"] else None,
            predicted=(predicted[0], predicted[1]) if predicted else None,
        )
        own, following = (LinearGaussianController(**state[name]) for name in ("own", "next"))
        return cls(search, own, following, state["cost"])


class GuidedPolicySearch:
    """Learns a time-varying linear-Gaussian controller in one context.

    Attributes:
        env: Environment for rollouts; all of its episodes have the same context.
        num_timesteps: Total number of control steps so far, over all episodes.
        last: Result of the last iteration; None before the first.
    """

    def __init__(self, config: LearnerConfig, env: Environment, seed: int):
        """Start with random actions of mean zero.

        Raises:
            UsageError: The reward tracks no target, the observation has no clock, episodes are too long, or the bound
                on the KL divergence is zero.
        """
        reward = env.reward
        if not isinstance(reward, TrackingReward):
            raise UsageError(f"--learner gps: expected --reward {', '.join(TRACKED_REWARDS)} (rewards with a target)")
        config.check_together()
        steps = env.timing.control_steps
        if steps > MOST_STEPS:
            raise UsageError(
                f"--learner gps fits dynamics at every control step: expected at most {MOST_STEPS} steps per episode, "
                f"{env.name} has {steps}; use --learner trpo"
            )
        if not env.has_clock:
            raise UsageError(
                f"--learner gps: the observation of {env.name} does not end with a clock; use --learner trpo"
            )
        self._reward = reward
        self._config, self._seed = config, seed
        self.env = env
        self.num_timesteps = 0
        self._size = env.observation_size - 1
        tracked = reward.targets.shape[1]
        std = float(np.exp(config.log_std))
        first = LinearGaussianController.constant(steps, self._size + tracked, env.action_size, std)
        own = LinearGaussianController.constant(steps, self._size, env.action_size, std)
        starts = config.starts if isinstance(config, PolicyConfig) else 1
        self._starts = [Start(Search(first), own, own)] * starts
        self._apart = starts * int(APART * config.iterations / starts) if starts > 1 else 0
        self._penalty = ACTION_COST * self._standing_still() * np.eye(env.action_size)
        self._cost = self._tracking()
        self.last: Improvement | None = None
        self._period = reward.frame_period
        self._iterations = 0
        self._refined = -1 if reward.finer is None else max(int(REFINED * config.iterations), 1, self._apart)
        self._fresh = False

    @property
    def controller(self) -> LinearGaussianController:
        """The controller for the next rollouts, which acts on the full state x."""
        return self._starts[self._turn].search.controller

    @property
    def own(self) -> LinearGaussianController:
        """The controller on the robot's own observation from the last rollouts of the lowest-cost search."""
        return self._cheapest().own

    @property
    def _turn(self) -> int:
        return self._iterations % len(self._starts)

    def _cheapest(self) -> Start:
        return min(self._starts, key=lambda start: start.cost)

    def learn(self, total_timesteps: int, reset_num_timesteps: bool = False) -> GuidedPolicySearch:
        """Run the episodes of one iteration and one update; same signature as `learn` of Stable-Baselines3.

        Raises:
            FloatingPointError: The cost of the rollouts is not finite.
        """
        if self._iterations == self._refined:
            self._refine()
        rng = generator(self._seed, "gps", self._iterations)
        states, actions = self.rollouts(rng)
        least_std = self._least_std(self._iterations + 1)
        cost = float(self._cost.of(states, actions).mean())
        if not math.isfinite(cost):
            raise FloatingPointError("the cost of the rollouts is not finite")
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
        """States (N, T + 1, dx) and actions (N, T, du) of all episodes of one iteration of the controller."""
        if not self._fresh:
            self.env.reset()  # The initial reset of a new environment does not count as an episode.
            self._fresh = True
        rounds = [self._round(rng) for _ in range(self.env.rounds)]
        return np.concatenate([states for states, _ in rounds]), np.concatenate([actions for _, actions in rounds])

    def _round(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """States (n, T + 1, dx) and actions (n, T, du) of one episode of the controller in every environment."""
        env, controller = self.env, self.controller
        states, actions = [self._state(env.moment)], []
        for step in range(controller.steps):
            noise = rng.standard_normal((env.num_envs, env.action_size))
            actions.append(controller.sample(step, states[-1], noise))
            _, _, done, _ = env.step(actions[-1])
            states.append(self._state(env.last if done[0] else env.moment))
        return np.stack(states, axis=1), np.stack(actions, axis=1)

    def _tracking(self) -> QuadraticCost:
        """The cost of tracking the current reward's targets."""
        targets, weights = self._reward.targets, self._reward.cost_weights
        return QuadraticCost.tracking(self._size + targets.shape[1], targets, weights, self._penalty)

    def _refine(self) -> None:
        """Continue with the reward's finer target, from the next controller on the robot's own observation.

        The remembered rollouts and the prior of the dynamics are discarded, because the tracked values are different
        now.
        """
        assert self._reward.finer is not None
        self._reward = self.env.reward = self._reward.finer
        self._cost = self._tracking()
        (start,) = self._starts
        lifted = start.next.lifted(self._size + self._reward.targets.shape[1])
        self._starts = [replace(start, search=Search(lifted.widened(self._least_std(self._iterations))))]

    def _least_std(self, iterations: int) -> float:
        """Minimum standard deviation of actions after `iterations` iterations."""
        left = max(1 - iterations / self._config.iterations, 0)
        return left * float(np.exp(min(EXPLORATION, self._config.log_std)))

    def _standing_still(self) -> float:
        """Mean cost per control step of staying in the initial state of the current episode."""
        seen = self._reward.tracked(self.env.moment).mean(axis=0)
        apart = np.square(self._reward.targets - seen).sum(axis=1)
        return max(float((0.5 * self._reward.cost_weights * apart).mean()), 1e-9)

    def _state(self, moment: Moment) -> np.ndarray:
        """States x (n, dx) at `moment`."""
        own = moment.observation[:, :-1].astype(np.float64)
        return np.concatenate([own, self._reward.tracked(moment)], axis=1)

    def state(self) -> dict[str, Any]:
        """The complete state that determines the rest of learning, as a tree of arrays and numbers."""
        return {
            "starts": [start.state() for start in self._starts],
            "iterations": self._iterations,
            "samples": self.num_timesteps,
            "episode": self.env.episode,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state returned by `state`, bit for bit."""
        iterations = int(state["iterations"])
        if 0 < self._apart <= iterations:
            self._starts = self._starts[:1]
        if 0 < self._refined < iterations:
            self._refine()
        starts = [Start.of(start) for start in state["starts"]]
        # Restarts that were given up are gone.
        if len(starts) not in (1, len(self._starts)) or any(one.shapes != self._starts[0].shapes for one in starts):
            raise ValueError("its controllers have other sizes")
        self._starts = starts
        self._iterations, self.num_timesteps = iterations, int(state["samples"])
        if self._iterations:
            self.env.episode = int(state["episode"]) - 1  # The current episode was drawn before; draw it again.
            self.env.reset()
            self._fresh = True
