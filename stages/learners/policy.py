"""A learned policy without its learner: what expert and policy artifacts hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.sac.policies import SACPolicy

from artifacts import Artifact, ArtifactError
from stages.state import from_tree, to_tree


def policy_weights(model: BaseAlgorithm) -> dict[str, np.ndarray]:
    """The weights of a learner's policy, named as in its state dict, under `weights/`."""
    return {f"weights/{name}": value for name, value in to_tree(model.policy.state_dict()).items()}


class Policy:
    """Maps observations to actions in [-1, 1]."""

    def __init__(self, network: BasePolicy):
        self._network = network.eval()

    @classmethod
    def of(cls, model: BaseAlgorithm) -> Policy:
        """The policy that a learner has now (shared, not copied)."""
        return cls(model.policy)

    @classmethod
    def load(cls, artifact: Artifact) -> Policy:
        """The policy that an expert or policy artifact holds.

        Raises:
            ArtifactError: The weights do not fit the network that the artifact's configuration describes.
        """
        config = artifact.config
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
        except RuntimeError as error:
            reason = " ".join(str(error).split())
            raise ArtifactError(
                f"{artifact.path}: the weights do not fit the network it describes ({reason})"
            ) from error
        return cls(network)

    def act(self, observation: np.ndarray, noise: torch.Generator | None = None) -> np.ndarray:
        """Actions (n, nu) for observations (n, D): the mean action, or a sample drawn with `noise`."""
        with torch.no_grad():
            if noise is None:
                return self._network.predict(observation, deterministic=True)[0]
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(int(torch.randint(2**62, (), generator=noise)))
                return self._network.predict(observation, deterministic=False)[0]
