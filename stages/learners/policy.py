"""Learned policies without their learners, as stored in expert and policy artifacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.sac.policies import SACPolicy

from artifacts import Artifact, ArtifactError
from stages.learners.algorithms import Learner
from stages.learners.gps.controller import LinearGaussianController
from stages.learners.gps.learner import GuidedPolicySearch
from stages.runtime.trees import from_tree, to_tree
from stages.simulation.task import Task


def policy_weights(model: Learner) -> dict[str, np.ndarray]:
    """Weights of a learner's policy under `weights/`, named as in its state dict; for GPS, the controller's arrays."""
    if isinstance(model, GuidedPolicySearch):
        return {f"weights/{name}": values for name, values in model.own.arrays().items()}
    return {f"weights/{name}": value for name, value in to_tree(model.policy.state_dict()).items()}


LAYERS = "mlp_extractor.policy_net", "action_net"  # of the policies of TRPO and PPO


class Policy:
    """Maps observations to actions in [-1, 1]."""

    def __init__(self, network: BasePolicy):
        self._network = network.eval()

    @classmethod
    def of(cls, model: Learner) -> Policy:
        """The current policy of a learner (shared, not copied)."""
        if isinstance(model, GuidedPolicySearch):
            return ControllerPolicy(model.own)
        return cls(model.policy)

    @classmethod
    def load(cls, artifact: Artifact) -> Policy:
        """Load the policy from an expert or policy artifact.

        Raises:
            ArtifactError: The weights do not fit the network described by the artifact's configuration.
        """
        config = artifact.config
        if config["learner"] == "gps":
            return ControllerPolicy.load(artifact)
        _check_width(artifact)
        observation = spaces.Box(-np.inf, np.inf, (config["observation_size"],), np.float32)
        action = spaces.Box(-1.0, 1.0, (config["action_size"],), np.float32)
        kwargs: dict[str, Any] = {"net_arch": [config["hidden"], config["hidden"]]}
        network: BasePolicy
        if config["learner"] == "sac":
            network = SACPolicy(observation, action, lambda _: 0.0, **kwargs)
        else:
            network = ActorCriticPolicy(observation, action, lambda _: 0.0, **kwargs)
        try:
            network.load_state_dict(from_tree(artifact.group("weights")))
        except (RuntimeError, TypeError) as error:
            reason = " ".join(str(error).split())
            raise ArtifactError(
                f"{artifact.path}: the weights do not fit the network in its configuration ({reason})"
            ) from error
        return cls(network)

    def act(self, observation: np.ndarray, noise: torch.Generator | None = None) -> np.ndarray:
        """Actions (n, nu) for observations (n, D): mean actions, or samples drawn with `noise`."""
        with torch.no_grad():
            if noise is None:
                return self._network.predict(observation, deterministic=True)[0]
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(int(torch.randint(2**62, (), generator=noise)))
                return self._network.predict(observation, deterministic=False)[0]


def _check_width(artifact: Artifact) -> None:
    """Check that the file holds a network as wide as its configuration says, before one is made.

    Raises:
        ArtifactError: It does not.
    """
    config = artifact.config
    layers, last = ("actor.latent_pi", "actor.mu") if config["learner"] == "sac" else LAYERS
    hidden = config["hidden"]
    wanted = {
        f"{layers}.0.weight": (hidden, config["observation_size"]),
        f"{layers}.2.weight": (hidden, hidden),
        f"{last}.weight": (config["action_size"], hidden),
    }
    described = artifact.describe()
    for name, shape in wanted.items():
        found, _ = described.get(f"weights/{name}", ((), None))
        if found != shape:
            raise ArtifactError(
                f"{artifact.path}: the weights do not fit the network in its configuration ({name} has shape {found}, "
                f"expected {shape})"
            )


def check_fits(artifact: Artifact, task: Task, observation: np.ndarray) -> None:
    """Check that a policy acts on observations like `observation` (n, D), with the actions of the task.

    Raises:
        ArtifactError: It was made for a task of other sizes.
    """
    found = artifact.config["observation_size"], artifact.config["action_size"]
    wanted = observation.shape[1], task.action_size
    if found != wanted:
        raise ArtifactError(
            f"{artifact.path}: a policy from {found[0]} observations to {found[1]} actions does not fit task "
            f"{task.name}, which has {wanted[0]} and {wanted[1]}: make it again"
        )


def first_observation(task: Task, expert: bool = False) -> np.ndarray:
    """What the policy (or the expert) observes first in some context (1, D)."""
    from stages.simulation.batch import BatchSimulation
    from stages.simulation.contexts import ContextDistribution

    contexts = task.draw_contexts(np.random.default_rng(0), 1, ContextDistribution())
    state = BatchSimulation(task, 1, 1).reset(*task.context_state(contexts))
    return task.observe_expert(state, contexts) if expert else task.observe(state)


class ControllerPolicy(Policy):
    """A time-varying linear-Gaussian controller as a policy; it reads the time step from the last observation entry."""

    def __init__(self, controller: LinearGaussianController):
        self._controller = controller

    @classmethod
    def load(cls, artifact: Artifact) -> ControllerPolicy:
        """Load the controller from a policy artifact of GPS.

        Raises:
            ArtifactError: The arrays do not form a valid controller, or do not have the configuration's sizes.
        """
        config = artifact.config
        weights = {name.removeprefix("weights/"): values for name, values in artifact.group("weights").items()}
        try:
            controller = LinearGaussianController.from_arrays(weights)
        except (KeyError, ValueError) as error:  # LinAlgError is a ValueError.
            raise ArtifactError(f"{artifact.path}: its weights do not form a valid controller ({error})") from error
        sizes = (config["action_size"], config["observation_size"] - 1)
        if controller.gains.shape[1:] != sizes:
            raise ArtifactError(
                f"{artifact.path}: gains have shape {controller.gains.shape[1:]}, expected {sizes} (action size, "
                "observation size - 1)"
            )
        return cls(controller)

    def act(self, observation: np.ndarray, noise: torch.Generator | None = None) -> np.ndarray:
        """Actions (n, nu) in [-1, 1] for observations (n, D) at the same time step: means, or drawn with `noise`."""
        steps = self._controller.steps
        step = min(round(float(observation[0, -1]) * steps), steps - 1)
        own = observation[:, :-1].astype(np.float64)
        if noise is None:
            return np.clip(self._controller.act(step, own), -1, 1)
        size = (len(own), self._controller.offsets.shape[1])
        drawn = torch.randn(size, generator=noise, dtype=torch.float64).numpy()
        return np.clip(self._controller.sample(step, own, drawn), -1, 1)
