"""All learners behind one interface and one configuration: TRPO, PPO and SAC from Stable-Baselines3, and GPS."""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import numpy as np
import torch
from sb3_contrib import TRPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger

from stages.config.stages import LearnerConfig
from stages.environments.protocol import Environment
from stages.learners.gps.learner import GuidedPolicySearch

Learner = BaseAlgorithm | GuidedPolicySearch
SAC_ROLLOUT = 50  # maximum number of control steps between SAC updates


def make_learner(config: LearnerConfig, env: Environment, seed: int) -> Learner:
    """Make a seeded learner for `env` that logs nothing itself; the caller logs."""
    if config.learner == "gps":
        return GuidedPolicySearch(config, env, seed)
    steps = env.timing.control_steps
    samples = steps * env.rounds * env.num_envs
    batch = next(k for k in range(max(samples // 10, 2), samples + 1) if samples % k == 0)
    layers = {"net_arch": [config.hidden, config.hidden]}
    model: BaseAlgorithm
    if config.learner == "trpo":
        model = TRPO(
            "MlpPolicy",
            env,
            n_steps=steps * env.rounds,
            batch_size=batch,
            learning_rate=config.critic_rate,
            gamma=config.discount,
            gae_lambda=config.gae_lambda,
            target_kl=config.kl,
            n_critic_updates=10,
            cg_max_steps=10,
            policy_kwargs={"log_std_init": config.log_std, **layers},
            seed=seed,
            device="cpu",
        )
    elif config.learner == "ppo":
        model = PPO(
            "MlpPolicy",
            env,
            n_steps=steps * env.rounds,
            batch_size=batch,
            learning_rate=0.1 * config.critic_rate,
            gamma=config.discount,
            gae_lambda=config.gae_lambda,
            target_kl=config.kl,
            n_epochs=10,
            policy_kwargs={"log_std_init": config.log_std, **layers},
            seed=seed,
            device="cpu",
        )
    else:
        # The rollout length divides the episode length, so that iterations and episodes end together.
        rollout = next(k for k in range(min(steps, SAC_ROLLOUT), 0, -1) if steps % k == 0)
        model = SAC(
            "MlpPolicy",
            env,
            learning_rate=0.1 * config.critic_rate,
            buffer_size=max(samples * min(config.iterations, 40), 1000),
            batch_size=256,
            gamma=config.discount,
            train_freq=rollout,
            gradient_steps=max(round(rollout * env.num_envs * config.updates), 1),
            learning_starts=0,
            policy_kwargs=layers,
            seed=seed,
            device="cpu",
        )
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def learner_state(model: Learner) -> dict[str, Any]:
    """The complete state that determines the rest of training, as a tree of arrays and numbers."""
    from stages.runtime.trees import to_tree

    if isinstance(model, GuidedPolicySearch):
        return model.state()
    variables = model._get_torch_save_params()[1]
    state = {
        "parameters": to_tree(model.get_parameters()),
        "variables": to_tree({name: getattr(model, name) for name in variables}),
        "torch": torch.get_rng_state().numpy(),
        "numpy": list(np.random.get_state(legacy=True)),  # SB3 shuffles minibatches with NumPy's global generator.
        "samples": int(model.num_timesteps),
        "updates": int(getattr(model, "_n_updates", 0)),
        "episode": model.env.episode if isinstance(model.env, Environment) else 0,
    }
    if isinstance(model, SAC) and (buffer := model.replay_buffer) is not None:
        names = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
        end = buffer.buffer_size if buffer.full else buffer.pos
        state["replay"] = {name: getattr(buffer, name)[:end] for name in names}
        state["replay_position"] = [int(buffer.pos), bool(buffer.full)]
    return state


def restore_learner(model: Learner, state: dict[str, Any]) -> None:
    """Restore a state returned by `learner_state`, bit for bit."""
    from stages.runtime.trees import check_optimiser, from_tree

    if isinstance(model, GuidedPolicySearch):
        model.restore(state)
        return
    model.set_parameters(from_tree(state["parameters"]), exact_match=True, device=model.device)
    for name in state["parameters"]:
        if name.endswith("optimizer"):
            check_optimiser(attrgetter(name)(model))
    for name, value in from_tree(state["variables"]).items():
        getattr(model, name).data.copy_(value)
    model.num_timesteps = int(state["samples"])
    model._n_updates = int(state["updates"])
    if isinstance(model, SAC) and (buffer := model.replay_buffer) is not None:
        for name, value in state["replay"].items():
            getattr(buffer, name)[: len(value)] = value
        position, full = state["replay_position"]
        buffer.pos, buffer.full = range(buffer.buffer_size)[position], bool(full)
    env = model.env
    assert isinstance(env, Environment)
    env.episode = int(state["episode"]) - 1  # The current episode was drawn before the state was saved; draw it again.
    model._last_obs = env.reset()
    model._last_episode_starts = np.ones(env.num_envs, bool)
    np.random.set_state(tuple(state["numpy"]))
    torch.set_rng_state(torch.from_numpy(np.asarray(state["torch"], np.uint8)))
